"""The trace of a run as arrays with one row per control period."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from egp_service.quantities import NU, NX, V_X

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service.control.step import Step


@dataclass(frozen=True, slots=True)
class Truth:
    """The simulated truth at the start of a control period."""

    time: float
    """Time since the start, s."""
    x: NDArray[np.float64]
    """`[p_x, p_y, v_x, psi, v_y, omega, delta]`."""
    friction: float
    """Friction coefficient under the vehicle; on a split road the mean of both sides."""
    distance: float
    """Distance driven along the path since the start, m."""
    path_s: float
    """Arc length of the vehicle's projection, m."""
    lateral_error: float
    """Signed distance from the reference path, m, positive to the left."""
    heading_error: float
    """Yaw less the path's direction, rad."""
    speed_reference: float
    """Reference speed, m/s."""
    friction_planned: float
    """Friction coefficient for which the reference speed is planned here; NaN if for none."""


@dataclass(frozen=True, slots=True)
class Period:
    """One control period: the truth at its start and the step taken."""

    truth: Truth
    measured: NDArray[np.float64]
    """Measured state (7,), which the step was computed for."""
    step: Step


@dataclass(frozen=True)
class Trace:
    """A run of n periods as columns."""

    time: NDArray[np.float64]
    x: NDArray[np.float64]
    u: NDArray[np.float64]
    friction: NDArray[np.float64]
    distance: NDArray[np.float64]
    lateral_error: NDArray[np.float64]
    heading_error: NDArray[np.float64]
    speed_error: NDArray[np.float64]
    friction_planned: NDArray[np.float64]
    friction_found: NDArray[np.float64]
    """(n, 2), 90 % interval of the friction that the last transitions indicate; NaN without a
    reply."""
    weights: NDArray[np.float64]
    """(n, N); NaN before the first reply."""
    step_time: NDArray[np.float64]
    """Time from the request of a step to its command, s."""
    mode: NDArray[np.str_]
    status: NDArray[np.str_]
    detail: NDArray[np.str_]
    """Why there is no plan, or why the vehicle counts as lost; empty otherwise."""

    @classmethod
    def of(cls, periods: list[Period], members: int) -> Trace:
        """Return the columns of `periods` for a library with `members` members."""
        truths = [period.truth for period in periods]
        steps = [period.step for period in periods]
        unknown = np.full(members, np.nan)
        columns = {
            "time": [truth.time for truth in truths],
            "x": np.array([truth.x for truth in truths]).reshape(-1, NX),
            "u": np.array([step.u for step in steps]).reshape(-1, NU),
            "friction": [truth.friction for truth in truths],
            "distance": [truth.distance for truth in truths],
            "lateral_error": [truth.lateral_error for truth in truths],
            "heading_error": [truth.heading_error for truth in truths],
            "speed_error": [truth.x[V_X] - truth.speed_reference for truth in truths],
            "friction_planned": [truth.friction_planned for truth in truths],
            "friction_found": np.array([_interval(step) for step in steps]).reshape(-1, 2),
            "weights": np.array(
                [step.weights if step.weights.size else unknown for step in steps]
            ).reshape(len(steps), members),
            "step_time": [step.timings.total for step in steps],
            "mode": [step.mode for step in steps],
            "status": [step.status for step in steps],
            "detail": [step.detail for step in steps],
        }
        return cls(**{item.name: np.asarray(columns[item.name]) for item in fields(cls)})

    def __len__(self) -> int:
        """Count the periods."""
        return len(self.time)


def _interval(step: Step) -> tuple[float, float]:
    friction = step.friction
    return (np.nan, np.nan) if friction is None else (friction.lower, friction.upper)
