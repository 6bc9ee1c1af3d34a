"""The compared controllers: the ensemble, its single members, and the baselines.

All drive with the same control step and the same settings; they differ in their library, or in how
they choose the weights of its members.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from egp_service._core import Library
from egp_service.control.controller import Controller
from egp_service.evaluation.window_noise import WindowNoise
from egp_service.quantities import MOTION, POSITION, gp_input
from egp_service.simulation.course import build_path
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.scenario import gate_settings, library_path

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike, NDArray

    from egp_service.control.step import Step
    from egp_service.simulation.scenario import Scenario

# The paper's weights: m/s and rad/s are added without scaling, and the prior is very weak.
PAPER_WEIGHTS: Final = {"whiten": False, "prior": {"kind": "l1", "alpha": 1e-5}}
ENSEMBLE: Final = "ensemble"
ORACLE: Final = "oracle"


class Oracle(Controller):
    """A controller that is told the true friction and interpolates between the nearest members."""

    def __init__(self, scenario: Scenario, told_from: int = 0) -> None:
        """Load the scenario's library; `told_from` is the first period with the oracle's weights.

        Before this period it estimates the weights as every other controller.
        """
        super().__init__(library_path(scenario), scenario.control, gate=gate_settings(scenario))
        self._path = build_path(scenario)
        self._s = 0.0
        self._untold = told_from
        self._frictions = np.array(self.frictions)

    def step(
        self,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        *,
        road_friction: ArrayLike | None = None,
        deadline: float | None = None,
    ) -> Step:
        """Set the weights from the true friction, then step."""
        projection = self._path.project(np.asarray(x, dtype=np.float64)[POSITION], self._s)
        self._s = projection.s
        if self._untold > 0:
            self._untold -= 1
        else:
            weights = interpolated_weights(self._frictions, projection.friction)
            self._driver.hold_weights(weights)
        return super().step(x, reference, widths, road_friction=road_friction, deadline=deadline)


class _Selection(Controller):
    """A controller that uses the member with the smallest error in the window, without blending."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(library_path(scenario), scenario.control, gate=gate_settings(scenario))
        self._library = Library.load(library_path(scenario))
        self._noise = WindowNoise(self._library.members, self.settings)
        self._errors: deque[NDArray[np.float64]] = deque(maxlen=self._noise.window)
        self._best = 0
        self._before: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def step(
        self,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        *,
        road_friction: ArrayLike | None = None,
        deadline: float | None = None,
    ) -> Step:
        """Select a member, then step."""
        state = np.asarray(x, dtype=np.float64)
        if self._before is not None:
            before, u = self._before
            z = gp_input(before, u)[None]
            y = (state - before)[MOTION]
            members = range(len(self.members))
            predicted = np.array([self._library.predict_mean(z, m)[0] for m in members])
            self._errors.append(predicted - y)
            errors = np.array(self._errors)
            level = self._noise.likeliest(errors[:, self._best])
            root = self._noise.whitening(level, len(errors))
            whitened = np.einsum("okj,jno->kno", root, errors)
            self._best = int(np.argmin(np.sum(whitened**2, axis=(0, 2))))
            self._driver.hold_weights(np.eye(len(self.members))[self._best])
        step = super().step(
            state, reference, widths, road_friction=road_friction, deadline=deadline
        )
        self._before = (state, step.u)
        return step


@dataclass(frozen=True, slots=True)
class Contender:
    """A compared controller. `members` are indices of the library's members that it uses."""

    name: str
    kind: str
    """`ensemble`, `oracle`, `selection`, or a kind of `baselines.KINDS`."""
    members: tuple[int, ...] = ()
    control: Mapping[str, object] | None = None
    """Settings that override the scenario's."""
    speed: Mapping[str, Any] | None = None
    """Fields of `Speed` that override the scenario's: what its reference speed knows."""
    disturbed: bool = False
    """Whether its members are those of a vehicle with the disturbance of the condition, in place of
    the evaluation library's."""
    variant: bool = False
    """Whether it is a variant of the ensemble, and so no baseline."""


def make(contender: Contender, scenario: Scenario) -> Controller:
    """Create the contender's controller; `scenario.library` is the contender's library."""
    own: dict[str, Callable[[Scenario], Controller]] = {"oracle": Oracle, "selection": _Selection}
    return own.get(contender.kind, in_process_controller)(scenario)


def interpolated_weights(frictions: NDArray[np.float64], friction: float) -> NDArray[np.float64]:
    """Weights (N,) by linear interpolation between the two members around `friction`.

    Outside the members' frictions the nearest member has the weight 1.
    """
    order = np.argsort(frictions)
    weights = np.zeros(len(frictions))
    position = np.interp(friction, frictions[order], np.arange(len(frictions)))
    below = min(int(position), max(0, len(frictions) - 2))
    weights[order[below]] = 1.0 - (position - below)
    if len(frictions) > 1:
        weights[order[below + 1]] = position - below
    return weights
