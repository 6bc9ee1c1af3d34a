"""The closed loop: simulated vehicle, reference and control step in lockstep.

In each period the plant waits for the step, and is then driven with the gate's command for `dt` of
simulated time. A step in this process may take any time, so that a slow machine slows the
simulation down without changing it. A service has the controller's deadline of real time, by
default 0.8 `dt`; missing it has the same effect as on a vehicle, mostly the tail of the last plan.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from egp_service._core import VehicleLostError, horizon_reference
from egp_service.control.step import EqualByValue
from egp_service.quantities import NU, NX, POSITION, PSI, V_X
from egp_service.simulation.course import build_path, build_profile, start_state
from egp_service.simulation.plant import make_plant, measurement_noise
from egp_service.simulation.reference import new_belief, speed_reference, told_reference
from egp_service.simulation.scenario import check_scenario, leave_distance
from egp_service.simulation.summary import Ending, Summary, summarise
from egp_service.simulation.trace import Period, Trace, Truth, row_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from egp_service._core import Path, Projection, RoadBelief
    from egp_service.control.step import StepController
    from egp_service.simulation.scenario import Scenario

# s; the first step may take longer because connections and caches are cold.
FIRST_DEADLINE = 2.0
# A run ends after this multiple of the time of the reference that is planned for the friction of
# all zones. A reference that does not use it is slower.
PATIENCE = {"zones": 2.0, "here": 4.0, "weights": 4.0, "nothing": 4.0}
STANDSTILL = 0.3
TOO_LONG = "took too long"
STOPPED = "stopped by the gate"


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Run(EqualByValue):
    """A finished run. Two are equal if they agree in all but the times that steps took."""

    scenario: Scenario
    members: Sequence[str]
    frictions: NDArray[np.float64]
    """(N,) friction coefficients of the members' surfaces; none if the controller does not state
    them, as with a service that has another library than the scenario."""
    dt: float
    """Control period, s."""
    deadline: float
    """Time that each step but the first had, s; see `StepController.deadline`."""
    trace: Trace
    summary: Summary

    def __repr__(self) -> str:
        """Return scenario, ending and the number of periods in one line."""
        ending = self.summary.ending
        return (
            f"<Run of {self.scenario.name}: {ending.reason} after {ending.time:g} s, "
            f"{len(self.trace)} periods of {self.dt:g} s>"
        )

    @property
    def path(self) -> Path:
        """The path, built on access because runs are passed between processes."""
        return build_path(self.scenario)


def drive(
    scenario: Scenario,
    controller: StepController,
    observe: Callable[[Period], None],
    belief: RoadBelief | None = None,
    told_from: int | None = None,
) -> Run:
    """Drive the scenario with `controller` and call `observe` with each period.

    `belief` is what earlier runs found about the road; what this run finds is added to it. It is
    used if the scenario has `speed.knows = "nothing"`. From the period with the number
    `told_from` on, the reference speed is planned for the true friction of all zones.

    A loss of control is not an exception but the run's ending.

    Raises:
        EgpError: if a value of the scenario is out of its range, its track cannot be built, or its
            `speed.knows` is "weights" and the controller does not state its `frictions`.

    """
    check_scenario(scenario, scenario.name)
    frictions = np.array(() if controller.frictions is None else controller.frictions)
    loop = _Loop(scenario, controller, frictions, belief, told_from)
    rows: list[dict[str, object]] = []
    ending = None
    while ending is None:
        period = loop.period()
        rows.append(row_of(period))
        observe(period)
        ending = loop.advance(period)
    trace = Trace.of(rows, len(controller.members))
    summary = summarise(
        trace,
        ending,
        scenario=scenario.name,
        library=controller.library.hex(),
        members=controller.members,
        dt=controller.dt,
    )
    return Run(
        scenario,
        controller.members,
        frictions,
        controller.dt,
        controller.deadline,
        trace,
        summary,
    )


class _Loop:
    """State of the closed loop between periods."""

    def __init__(
        self,
        scenario: Scenario,
        controller: StepController,
        frictions: NDArray[np.float64],
        belief: RoadBelief | None,
        told_from: int | None,
    ) -> None:
        self._scenario = scenario
        self._controller = controller
        self.path = build_path(scenario)
        belief = new_belief(scenario, self.path) if belief is None else belief
        self._leave = leave_distance(scenario)
        belief.window = controller.history
        self._speed = speed_reference(scenario, self.path, belief, frictions)
        self._told_from = told_from
        self._noise = measurement_noise(scenario.measurement)
        self._random = np.random.default_rng(scenario.seed)
        self._plant = make_plant(scenario, self.path)
        # Commands that have not yet reached the wheels.
        self._pending = deque([np.zeros(NU)] * scenario.actuator_delay)
        self._s = 0.0
        self._distance = 0.0
        self._ticks = 0
        # Why the gate began to stop the vehicle.
        self._stopped = ""
        laps = scenario.laps if self.path.closed else 1.0
        self._goal = laps * self.path.length
        told = laps * build_profile(scenario, self.path).lap_time
        self._time_limit = 10.0 + PATIENCE[scenario.speed.knows] * told
        v_start = scenario.speed.v_start
        if v_start is None:
            profile, _ = self._speed.plan(0.0, None)
            v_start = float(profile.speed(np.zeros(1))[0])
        self._plant.reset(start_state(scenario, self.path, v_start))
        self._x = self._plant.state

    @property
    def _time(self) -> float:
        return self._ticks * self._controller.dt

    def period(self) -> Period:
        """Compute the step of this period."""
        x = self._x = self._plant.state
        projection = self._project(x)
        if self._ticks == self._told_from:
            self._speed = told_reference(self._scenario, self.path)
        measured = x + self._noise * self._random.standard_normal(NX)
        profile, planned = self._speed.plan(projection.s, float(measured[V_X]))
        truth = Truth(
            time=self._time,
            x=x,
            friction=projection.friction,
            distance=self._distance,
            path_s=projection.s,
            lateral_error=projection.lateral,
            heading_error=_wrap(x[PSI] - projection.yaw),
            speed_reference=float(profile.speed(np.array([projection.s]))[0]),
            friction_planned=planned,
        )
        reference, widths, _ = horizon_reference(
            self.path,
            profile,
            measured,
            self._controller.dt,
            self._controller.horizon,
            self._s,
        )
        steps = np.hypot(*np.diff(reference[:, POSITION], axis=0).T)
        step = self._controller.step(
            measured,
            reference,
            widths,
            road_friction=self._speed.road_friction(
                projection.s + np.concatenate(([0.0], np.cumsum(steps)))
            ),
            deadline=FIRST_DEADLINE if self._ticks == 0 else None,
        )
        self._speed.found(step)
        return Period(truth, measured, step)

    def advance(self, period: Period) -> Ending | None:
        """Drive one period; return the ending if the run ends."""
        dt = self._controller.dt
        self._pending.append(period.step.u)
        u = self._pending.popleft()
        try:
            self._plant.drive(u, dt, self._s)
        except VehicleLostError as error:
            return self._ending(f"lost control: {error}")
        self._ticks += 1
        if self._distance >= self._goal:
            return self._ending("completed")
        lateral = period.truth.lateral_error
        if abs(lateral) > self._leave:
            return self._ending(f"more than {self._leave:g} m beside the path: {lateral:+.2f} m")
        if period.step.mode == "stop":
            self._stopped = self._stopped or period.step.detail or period.step.status
            if self._plant.state[V_X] < STANDSTILL or abs(lateral) > self._leave:
                return self._ending(f"{STOPPED}: {self._stopped}")
        if self._time > self._time_limit:
            return self._ending(TOO_LONG)
        return None

    def _project(self, x: NDArray[np.float64]) -> Projection:
        """Project the vehicle onto the path and update the driven distance."""
        projection = self.path.project(x[POSITION], self._s)
        advanced = projection.s - self._s
        if self.path.closed:
            advanced -= self.path.length * round(advanced / self.path.length)
        self._distance += advanced
        self._s = projection.s
        return projection

    def _ending(self, reason: str) -> Ending:
        last, lost = self._x[POSITION], self._plant.state[POSITION]
        p_x, p_y = lost if np.isfinite(lost).all() else last
        return Ending(
            completed=reason == "completed",
            reason=reason,
            time=self._time,
            distance=self._distance,
            position=(float(p_x), float(p_y)),
        )


def _wrap(angle: float) -> float:
    """Angle in [-pi, pi)."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)
