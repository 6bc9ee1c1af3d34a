"""The figures of a run: did it come through, how precisely, how fast was the control step."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from egp_service.quantities import V_X

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from egp_service.simulation.trace import Trace


@dataclass(frozen=True, slots=True)
class Ending:
    """How a run ended."""

    completed: bool
    reason: str
    """"completed", or what went wrong."""
    time: float
    distance: float
    """Where, m along the path from the start."""
    position: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Error:
    """Largest magnitude and root mean square."""

    max: float
    rms: float

    @classmethod
    def of(cls, values: NDArray[np.float64]) -> Error:
        """Summarise the errors of a run that has at least one period."""
        return cls(float(np.max(np.abs(values))), float(np.sqrt(np.mean(values**2))))


@dataclass(frozen=True, slots=True)
class Summary:
    """Everything worth comparing between runs."""

    scenario: str
    library: str
    members: tuple[str, ...]
    ending: Ending
    periods: int
    dt: float
    lateral_error: Error
    """m."""
    speed_error: Error
    """m/s."""
    mean_speed: float
    step_time_ms: dict[str, float]
    """Percentiles of asking for a step to having the command: p50, p90, p99, max."""
    deadline_misses: int
    """Periods in which no usable plan came within `dt`."""
    tail_ticks: int
    stop_ticks: int
    solver_statuses: dict[str, int]

    def as_json(self) -> dict[str, object]:
        """Plain values."""
        return asdict(self)


def summarise(
    trace: Trace, ending: Ending, *, scenario: str, library: str, members: Sequence[str], dt: float
) -> Summary:
    """Summary of a run of at least one period."""
    milliseconds = 1e3 * trace.step_time
    p50, p90, p99 = np.percentile(milliseconds, [50, 90, 99])
    return Summary(
        scenario=scenario,
        library=library,
        members=tuple(members),
        ending=ending,
        periods=len(trace),
        dt=dt,
        lateral_error=Error.of(trace.lateral_error),
        speed_error=Error.of(trace.speed_error),
        mean_speed=float(np.mean(trace.x[:, V_X])),
        step_time_ms={
            "p50": float(p50),
            "p90": float(p90),
            "p99": float(p99),
            "max": float(np.max(milliseconds)),
        },
        deadline_misses=int(np.isin(trace.status, ("late", "unreachable")).sum()),
        tail_ticks=int(np.sum(trace.mode == "tail")),
        stop_ticks=int(np.sum(trace.mode == "stop")),
        solver_statuses=dict(sorted(Counter(trace.status.tolist()).items())),
    )
