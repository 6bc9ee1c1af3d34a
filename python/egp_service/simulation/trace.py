"""The trace of a run as arrays with one row per control period."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

from egp_service.control.step import EqualByValue
from egp_service.quantities import V_X

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from egp_service.control.step import Step


@dataclass(frozen=True, slots=True, eq=False)
class Truth(EqualByValue):
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


@dataclass(frozen=True, slots=True, eq=False)
class Period(EqualByValue):
    """One control period: the truth at its start and the step taken."""

    truth: Truth
    measured: NDArray[np.float64]
    """Measured state (7,), which the step was computed for."""
    step: Step


@dataclass(frozen=True, repr=False, eq=False)
class Trace(EqualByValue):
    """A run of n periods as columns. Two are equal if all columns but `step_time` are."""

    time: NDArray[np.float64]
    """Time since the start (n,), s."""
    x: NDArray[np.float64]
    """True states (n, 7), `[p_x, p_y, v_x, psi, v_y, omega, delta]` in SI units and rad."""
    u: NDArray[np.float64]
    """Commands of the gate (n, 2), force in N and steering rate in rad/s."""
    friction: NDArray[np.float64]
    """True friction coefficient under the vehicle (n,)."""
    distance: NDArray[np.float64]
    """Distance along the path since the start (n,), m."""
    lateral_error: NDArray[np.float64]
    """Distance from the path (n,), m, positive to its left."""
    heading_error: NDArray[np.float64]
    """Yaw relative to the path's direction (n,), rad."""
    speed_error: NDArray[np.float64]
    """Speed less the reference speed (n,), m/s."""
    friction_planned: NDArray[np.float64]
    """Friction coefficient for which the reference speed here is planned (n,)."""
    friction_found: NDArray[np.float64]
    """(n, 2), 90 % interval of the friction that the last transitions indicate; NaN without a
    reply."""
    misfit: NDArray[np.float64]
    """(n,), `Friction.misfit` where the last transitions have information about the friction; NaN
    elsewhere."""
    weights: NDArray[np.float64]
    """(n, N); NaN before the first reply."""
    step_time: NDArray[np.float64] = field(compare=False)
    """Time from the request of a step to its command, s."""
    mode: NDArray[np.str_]
    """`Step.mode` (n,)."""
    status: NDArray[np.str_]
    """`Step.status` (n,)."""
    detail: NDArray[np.str_]
    """Why there is no plan, or why the vehicle counts as lost; empty otherwise."""

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, object]], members: int) -> Trace:
        """Return the columns of at least one row of `row_of`, for a library of `members` members.

        Rows without weights get NaN (N,).
        """
        unknown = np.full(members, np.nan)
        columns = {item.name: [row[item.name] for row in rows] for item in fields(cls)}
        columns["weights"] = [unknown if each is None else each for each in columns["weights"]]
        return cls(**{name: np.asarray(column) for name, column in columns.items()})

    def __repr__(self) -> str:
        """Return the number of periods."""
        return f"<Trace of {len(self)} periods>"

    def __len__(self) -> int:
        """Count the periods."""
        return len(self.time)


def row_of(period: Period) -> dict[str, object]:
    """Return a row of a trace by column, which keeps nothing else of the period.

    A step has 15 kB of messages and plan. The weights are `None` before the first reply.
    """
    truth, step, found = period.truth, period.step, period.step.friction
    return {
        "time": truth.time,
        "x": truth.x,
        "u": step.u,
        "friction": truth.friction,
        "distance": truth.distance,
        "lateral_error": truth.lateral_error,
        "heading_error": truth.heading_error,
        "speed_error": truth.x[V_X] - truth.speed_reference,
        "friction_planned": truth.friction_planned,
        "friction_found": (found.lower, found.upper) if found else (np.nan, np.nan),
        "misfit": found.misfit if found and found.informed else np.nan,
        "weights": step.weights if step.weights.size else None,
        "step_time": step.timings.total,
        "mode": step.mode,
        "status": step.status,
        "detail": step.detail,
    }
