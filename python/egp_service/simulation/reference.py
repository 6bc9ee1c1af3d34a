"""The reference speed of a run, by what is known about the road's friction."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np

from egp_service._core import EgpError, RoadBelief, SpeedPlanner
from egp_service.files import replacing
from egp_service.simulation.course import build_path, build_profile, tyre_grips
from egp_service.simulation.scenario import vehicle_parameters
from egp_service.simulation.scenario_checks import ScenarioError, why_unused

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service._core import Friction, Path, SpeedProfile
    from egp_service.control.step import Step
    from egp_service.simulation.scenario import Scenario


class SpeedReference(ABC):
    """Plans the reference speed, once in each control period."""

    @abstractmethod
    def plan(self, s: float, v: float | None) -> tuple[SpeedProfile, float]:
        """Return the profile for a vehicle at `s` with the speed `v`, and the friction there.

        The friction is that for which the speed is planned, NaN if the speed does not depend on it.
        Without `v` the profile begins with the largest speed.
        """

    def road_friction(self, _places: NDArray[np.float64], /) -> NDArray[np.float64] | None:
        """Return what is known about the road at places (n,), as rows for the control step."""
        return None

    def found(self, step: Step) -> None:  # noqa: B027 - most references learn nothing
        """Take note of what the last control step found."""


class _Given(SpeedReference):
    """A profile of the whole path."""

    def __init__(self, scenario: Scenario, path: Path) -> None:
        self._profile = build_profile(scenario, path)
        self._path = None if scenario.speed.constant else path

    def plan(self, s: float, v: float | None) -> tuple[SpeedProfile, float]:  # noqa: ARG002
        """Return the same profile everywhere."""
        if self._path is None:
            return self._profile, float("nan")
        return self._profile, _friction_at(self._path, s)


class _Planned(SpeedReference):
    """A plan from the vehicle's place and speed on."""

    def __init__(self, scenario: Scenario, path: Path) -> None:
        car = vehicle_parameters(scenario)
        speed = scenario.speed
        self._planner = SpeedPlanner(path, car, speed.grip, speed.v_max, tyres=tyre_grips(scenario))

    def plan(self, s: float, v: float | None) -> tuple[SpeedProfile, float]:
        """Plan for the friction that is believed."""
        friction = self._friction(s, self._planner.places(s))
        return self._planner.plan(s, friction, v), float(friction[0])

    @abstractmethod
    def _friction(self, s: float, places: NDArray[np.float64], /) -> NDArray[np.float64]:
        """Return the friction to plan for at the places, of which `s` is the vehicle's."""


class _Believed(_Planned):
    """The friction that control steps found."""

    def __init__(self, scenario: Scenario, path: Path, belief: RoadBelief) -> None:
        super().__init__(scenario, path)
        self._risk = scenario.speed.risk
        self._preview = scenario.speed.preview
        self._belief = belief
        self._found: Friction | None = None

    def found(self, step: Step) -> None:
        self._found = step.friction
        if step.held_up or step.status == "invalid_state":
            self._belief.leave()  # the window starts anew, and with it the places that it covers

    def road_friction(self, places: NDArray[np.float64], /) -> NDArray[np.float64] | None:
        return self._belief.preview(places) if self._preview else None

    def _friction(self, s: float, places: NDArray[np.float64], /) -> NDArray[np.float64]:
        found = self._found
        self._belief.update(s, None if found is None else found.log_likelihood)
        return self._belief.ahead(places, self._risk)


class _Here(_Planned):
    """The friction under the vehicle, everywhere."""

    def __init__(self, scenario: Scenario, path: Path) -> None:
        super().__init__(scenario, path)
        self._path = path
        self._most = scenario.speed.friction or float("inf")

    def _friction(self, s: float, places: NDArray[np.float64], /) -> NDArray[np.float64]:
        return np.full_like(places, min(self._most, _friction_at(self._path, s)))


class _Weighted(_Planned):
    """The members' friction coefficients, blended with the last weights, everywhere."""

    def __init__(self, scenario: Scenario, path: Path, frictions: NDArray[np.float64]) -> None:
        super().__init__(scenario, path)
        if frictions.size == 0:
            raise ScenarioError(
                "speed.knows is 'weights', but the controller does not state the frictions of its "
                "members, as with a service that has another library than the scenario: name the "
                "service's own library in the scenario"
            )
        self._frictions = frictions
        self._most = scenario.speed.friction or float("inf")
        self._blended = float(self._frictions.mean())  # the first step begins with equal weights

    def found(self, step: Step) -> None:
        if step.weights.size:
            self._blended = float(step.weights @ self._frictions)

    def _friction(self, _s: float, places: NDArray[np.float64], /) -> NDArray[np.float64]:
        return np.full_like(places, min(self._most, self._blended))


class _Assumed(_Planned):
    """One friction everywhere."""

    def __init__(self, scenario: Scenario, path: Path, friction: float) -> None:
        super().__init__(scenario, path)
        self._assumed = friction

    def _friction(self, _s: float, places: NDArray[np.float64], /) -> NDArray[np.float64]:
        return np.full_like(places, self._assumed)


class _Told(_Planned):
    """The true friction of all zones, each place with the lowest within a step as in a profile."""

    def __init__(self, scenario: Scenario, path: Path) -> None:
        super().__init__(scenario, path)
        self._path = path

    def _friction(self, _s: float, places: NDArray[np.float64], /) -> NDArray[np.float64]:
        step = places[1] - places[0]
        before, here, after = (self._path.sample(places + d)[-1] for d in (-step, 0.0, step))
        return np.minimum(np.minimum(before, here), after)

    def road_friction(self, places: NDArray[np.float64], /) -> NDArray[np.float64]:
        # The weights are those of the friction under the vehicle, so that this is the one behind.
        friction = self._path.sample(np.concatenate((places[:1], places)))[-1]
        return np.column_stack((friction, np.zeros_like(friction)))


def told_reference(scenario: Scenario, path: Path) -> SpeedReference:
    """Return a reference speed for all zones, planned from the vehicle's place and speed on.

    Unlike the profile of a whole path it fits a vehicle of any speed: it brakes with all grip where
    the vehicle is too fast for what lies ahead.
    """
    return _Told(scenario, path)


def speed_reference(
    scenario: Scenario, path: Path, belief: RoadBelief, frictions: NDArray[np.float64]
) -> SpeedReference:
    """Return the reference speed of a scenario.

    `belief` is what is known from earlier runs, `frictions` (N,) the friction coefficients of the
    controller's members, none if they are not known.
    """
    speed = scenario.speed
    if speed.constant or speed.knows == "zones":
        return _Given(scenario, path)
    if speed.knows == "here":
        return _Here(scenario, path)
    if speed.knows == "weights":
        return _Weighted(scenario, path, frictions)
    if speed.friction is not None:
        return _Assumed(scenario, path, speed.friction)
    return _Believed(scenario, path, belief)


def new_belief(scenario: Scenario, path: Path) -> RoadBelief:
    """Return a belief without evidence about the scenario's road.

    Its scale is the power of two nearest to that of the vehicle, so that vehicles of nearly the
    same size share what they find.
    """
    scale = vehicle_parameters(scenario).scale
    return RoadBelief(path, scale=2.0 ** round(math.log2(scale)))


def load_belief(scenario: Scenario, file: str | FilePath | None) -> RoadBelief:
    """Return what `file` says about the scenario's road; nothing is known without such a file.

    Its evidence has aged since the file was written.

    Raises:
        ScenarioError: if the file cannot be read, or is about another road, or if the reference
            speed of the scenario does not use what is known.

    """
    if file is not None and (reason := why_unused(scenario.speed)):
        raise ScenarioError(f"{scenario.name}: --road {file} has no effect while {reason}")
    belief = new_belief(scenario, build_path(scenario))
    known = None if file is None else FilePath(file)
    if known is not None and known.exists():
        try:
            content, age = known.read_bytes(), time.time() - known.stat().st_mtime
        except OSError as error:
            raise ScenarioError(f"{file}: {error.strerror}; name another file") from error
        try:
            belief.recall(content, max(0.0, age))
        except EgpError as error:
            raise ScenarioError(
                f"{file}: {error}; delete it to begin anew, or name another file"
            ) from error
    return belief


def store_belief(belief: RoadBelief, file: str | FilePath) -> None:
    """Write what is known about a road to `file`, which is replaced when it is complete."""
    with replacing(FilePath(file)) as beside:
        beside.write_bytes(belief.to_bytes())


def _friction_at(path: Path, s: float) -> float:
    """Return the true friction at `s`, the mean of both sides of a split road."""
    return float(path.sample(np.array([s]))[-1][0])
