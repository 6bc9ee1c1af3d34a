"""Who drives: the ensemble, its members alone, and the baselines.

All solve the same optimal control problem with the same solver, settings and gate; they differ in
what predicts the vehicle.
"""

from __future__ import annotations

import tomllib
from collections import deque
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import Carry, EgpError, Engine, Library, VehicleParameters
from egp_service.controller import Controller
from egp_service.course import build_path
from egp_service.evaluation.predictive_control import PredictiveController
from egp_service.evaluation.single_track import (
    CHASSIS,
    NOMINAL_FRICTION,
    Kinematic,
    SingleTrack,
    linearise,
)
from egp_service.evaluation.window_noise import WindowNoise
from egp_service.scenario import gate_settings, library_path
from egp_service.toml_text import dumps

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike, NDArray

    from egp_service.closed_loop import Drives
    from egp_service.evaluation.single_track import Prediction
    from egp_service.scenario import Scenario
    from egp_service.stepper import Step

# The paper's weights: errors of m/s and rad/s added up, and no pull towards the previous weights.
PAPER_WEIGHTS: Final = {"whiten": False, "prior": {"kind": "l1", "alpha": 1e-5}}
ENSEMBLE: Final = "ensemble"
ORACLE: Final = "oracle"


class _Oracle(Controller):
    """Knows the friction under the vehicle: weights interpolated between the nearest members."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(
            library_path(scenario), dumps(scenario.control), gate=gate_settings(scenario)
        )
        self._carry = Carry(self.library, 0)
        self._path = build_path(scenario)
        self._s = 0.0
        members = Library.load(library_path(scenario)).members
        self._frictions = np.array([member.friction for member in members])

    def step(
        self,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        *,
        deadline: float | None = None,
    ) -> Step:
        """Set the weights, then step."""
        projection = self._path.project(np.asarray(x, dtype=np.float64)[:2], self._s)
        self._s = projection.s
        self._carry.weights = interpolated_weights(self._frictions, projection.friction)
        return super().step(x, reference, widths, deadline=deadline)


class _Selection(Controller):
    """Takes the one member that predicted the window best, instead of blending."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(
            library_path(scenario), dumps(scenario.control), gate=gate_settings(scenario)
        )
        self._carry = Carry(self.library, 0)
        self._library = Library.load(library_path(scenario))
        self._noise = WindowNoise(
            self._library.members, tomllib.loads(_engine(scenario).settings_toml)
        )
        self._errors: deque[NDArray[np.float64]] = deque(maxlen=self._noise.window)
        self._best = 0
        self._before: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def step(
        self,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        *,
        deadline: float | None = None,
    ) -> Step:
        """Select, then step."""
        state = np.asarray(x, dtype=np.float64)
        if self._before is not None:
            before, u = self._before
            z = np.concatenate([before[[2, 4, 5, 6]], u])[None]
            y = (state - before)[[2, 4, 5]]
            members = range(len(self.members))
            predicted = np.array([self._library.predict(z, m)[0][0] for m in members])
            self._errors.append(predicted - y)
            errors = np.array(self._errors)
            level = self._noise.likeliest(errors[:, self._best])
            root = self._noise.whitening(level, len(errors))
            whitened = np.einsum("okj,jno->kno", root, errors)
            self._best = int(np.argmin(np.sum(whitened**2, axis=(0, 2))))
            self._carry.weights = np.eye(len(self.members))[self._best]
        step = super().step(state, reference, widths, deadline=deadline)
        self._before = (state, step.u)
        return step


@dataclass(frozen=True, slots=True)
class Contender:
    """One way to drive. `members` are the library's it may use (by index)."""

    name: str
    kind: str
    """`ensemble`, `oracle`, `selection`, `kinematic` or `single-track`."""
    members: tuple[int, ...] = ()
    control: Mapping[str, object] | None = None
    """Settings over the scenario's."""


def make(contender: Contender, scenario: Scenario) -> Drives:
    """Make the contender's stepper; `scenario.library` holds its members already.

    Raises `EgpError` for an unknown kind.
    """
    makers: dict[str, Callable[[], Drives]] = {
        "ensemble": lambda: Controller(
            library_path(scenario), dumps(scenario.control), gate=gate_settings(scenario)
        ),
        "oracle": lambda: _Oracle(scenario),
        "selection": lambda: _Selection(scenario),
        "kinematic": lambda: _predictive(scenario, Kinematic(CHASSIS[scenario.vehicle])),
        "single-track": lambda: _predictive(scenario, SingleTrack(CHASSIS[scenario.vehicle])),
    }
    if contender.kind not in makers:
        raise EgpError(f"no contender of kind {contender.kind!r}; known: {', '.join(makers)}")
    return makers[contender.kind]()


def interpolated_weights(frictions: NDArray[np.float64], friction: float) -> NDArray[np.float64]:
    """Weights (N,) of the two members around `friction`, linear in between; the nearest outside."""
    order = np.argsort(frictions)
    weights = np.zeros(len(frictions))
    position = np.interp(friction, frictions[order], np.arange(len(frictions)))
    below = min(int(position), max(0, len(frictions) - 2))
    weights[order[below]] = 1.0 - (position - below)
    if len(frictions) > 1:
        weights[order[below + 1]] = position - below
    return weights


def _engine(scenario: Scenario) -> Engine:
    return Engine(str(library_path(scenario)), dumps(scenario.control))


def _predictive(scenario: Scenario, prediction: Prediction) -> PredictiveController:
    engine = _engine(scenario)
    return PredictiveController(
        partial(linearise, prediction, dt=engine.dt),
        engine.settings_toml,
        engine.dt,
        vehicle=VehicleParameters.commonroad(scenario.vehicle),
        mass=CHASSIS[scenario.vehicle].mass,
        friction=NOMINAL_FRICTION,
        gate=gate_settings(scenario),
    )
