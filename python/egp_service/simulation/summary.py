"""The summary of a run: completion, tracking errors, friction and times of the control step."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.quantities import V_X

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from egp_service.simulation.trace import Trace

# Reasons that name numbers differ in each period.
_REASONS: Final = 10
# Periods from which the median misfit is stated: 250, of which ten windows share no transition. A
# larger one needs fewer, because slides of a vehicle that the members predict remain below it.
_ENOUGH: Final = 250
_LARGE: Final = (10, 20.0)


@dataclass(frozen=True, slots=True)
class Ending:
    """How a run ended."""

    completed: bool
    reason: str
    """"completed", or the cause of an early end."""
    time: float
    """Time since the start, s."""
    distance: float
    """Distance along the path from the start, m."""
    position: tuple[float, float]
    """Position at the end, or the last finite one, m."""


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
class FrictionFound:
    """The friction that was found and planned for, beside the true one under the vehicle.

    Coverage and width are those of the 90 % interval in the informed periods, whose last
    transitions have information about the friction; without such a period they are none.
    """

    informed: int
    """Number of informed periods."""
    coverage: float | None
    """Share of the intervals that hold the true friction."""
    median_width: float | None
    """Median of the upper less the lower end."""
    planned_over_true: float | None
    """Mean ratio of the friction for which the reference speed is planned; none if for none."""
    misfit: float | None
    """Median of `Friction.misfit` over the periods with information about the friction; none with
    fewer than 250 of them, or with fewer than 10 if it is above 20."""

    @classmethod
    def of(cls, trace: Trace) -> FrictionFound:
        """Compare the columns of a run."""
        informed = np.isfinite(trace.misfit)
        lower, upper = trace.friction_found[informed].T
        holds = (lower <= trace.friction[informed]) & (trace.friction[informed] <= upper)
        planned = trace.friction_planned / trace.friction
        misfit = trace.misfit[informed]
        median = float(np.median(misfit)) if informed.any() else 0.0
        few, large = _LARGE
        enough = few if median > large else _ENOUGH
        return cls(
            informed=int(informed.sum()),
            coverage=float(np.mean(holds)) if informed.any() else None,
            median_width=float(np.median(upper - lower)) if informed.any() else None,
            planned_over_true=float(np.nanmean(planned)) if np.isfinite(planned).any() else None,
            misfit=median if len(misfit) >= enough else None,
        )


@dataclass(frozen=True, slots=True)
class Summary:
    """Results of a run that are compared between runs; two are equal if all but their times are."""

    scenario: str
    library: str
    members: tuple[str, ...]
    ending: Ending
    periods: int
    """Number of control periods."""
    dt: float
    """Control period, s."""
    lateral_error: Error
    """Distance from the path, m."""
    speed_error: Error
    """Difference from the reference speed, m/s."""
    mean_speed: float
    """Mean of `v_x` over the periods, m/s."""
    step_time_ms: dict[str, float] = field(compare=False)
    """Percentiles of the time from request to command: p50, p90, p99, max."""
    deadline_misses: int
    """Number of periods in which no answer came before the deadline, which is 0.8 `dt` by default;
    none in this process, where a step may take any time."""
    tail_ticks: int
    """Number of periods in the mode `tail`."""
    stop_ticks: int
    """Number of periods in the mode `stop`."""
    solver_statuses: dict[str, int]
    """Number of periods with each status of the step."""
    no_plan_reasons: dict[str, int]
    """Why periods had no plan, the ten most frequent reasons with their numbers of periods."""
    friction: FrictionFound | None = None

    def as_json(self) -> dict[str, object]:
        """Plain values."""
        return asdict(self)


def summarise(
    trace: Trace, ending: Ending, *, scenario: str, library: str, members: Sequence[str], dt: float
) -> Summary:
    """Summary of a run of at least one period."""
    milliseconds = 1e3 * trace.step_time
    reasons = Counter(
        f"{status}: {detail}"
        for status, detail in zip(trace.status.tolist(), trace.detail.tolist(), strict=True)
        if status != "solved"
    )
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
        no_plan_reasons=dict(reasons.most_common(_REASONS)),
        friction=FrictionFound.of(trace),
    )
