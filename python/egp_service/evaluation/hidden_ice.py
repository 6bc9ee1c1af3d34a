"""A patch of ice on a dry lap, at a place that the controller does not know.

The laps after it was found count.
"""

from __future__ import annotations

import itertools
import operator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.evaluation.contenders import ORACLE, Contender, make
from egp_service.evaluation.departures import avoidable
from egp_service.evaluation.experiment import (
    CUSTOM_TRACK,
    TWO,
    ClosedLoopExperiment,
    on_surfaces,
)
from egp_service.evaluation.unknown_roads import believing, informed
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.course import build_path
from egp_service.simulation.reference import new_belief
from egp_service.simulation.scenario import Zone

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from egp_service._core import Path
    from egp_service.evaluation.experiment import Trial
    from egp_service.simulation.closed_loop import Run
    from egp_service.simulation.scenario import Scenario
    from egp_service.simulation.trace import Period

NAME: Final = "hidden-ice"
LARGEST_ERROR: Final = 0.3
"""Largest lateral error of a lap after the patch was found, m."""
_DRY: Final = 1.1
_ICE: Final = 0.25
_LENGTHS: Final = (5.0, 10.0, 20.0)
_RISKS: Final = (0.03, 0.05)
# A place is in a bend above this share of the largest curvature, and on a straight below the other.
_BEND: Final = 0.5
_STRAIGHT: Final = 0.02


@dataclass(frozen=True, slots=True)
class IceOutcome:
    """Result of one run over several laps."""

    experiment: str
    condition: str
    contender: str
    seed: int
    completed: bool
    reason: str
    lap_errors: tuple[float, ...]
    """Largest lateral error of each lap, m; the last lap of a departure is incomplete."""
    believed: tuple[float, ...]
    """Median of the belief about the friction in the middle of the patch, before each lap and after
    the last one; empty for a reference speed that is told all zones."""
    avoidable: bool | None
    """Whether a replay that is told everything avoids the departure; None without a departure, or
    if the replay does not tell."""

    @property
    def found(self) -> tuple[bool, ...]:
        """Whether the patch was found before each lap: less than the middle of both frictions."""
        return tuple(median < 0.5 * (_DRY + _ICE) for median in self.believed)

    @property
    def errors_after(self) -> tuple[float, ...]:
        """Largest lateral errors of the laps after the patch was found, m."""
        ever = itertools.accumulate(self.found, operator.or_)
        pairs = zip(self.lap_errors, ever, strict=False)
        return tuple(error for error, found in pairs if found)


def experiment() -> ClosedLoopExperiment:
    """Return the experiment: patches of three lengths, in a bend and on a straight, three laps."""
    path = build_path(on_surfaces(CUSTOM_TRACK, ((0.0, _DRY),), 0.9))
    bend, straight = (places[len(places) // 2] for places in _places(path))
    return ClosedLoopExperiment(
        NAME,
        "A patch of ice on a dry lap (beyond the paper)",
        f"A patch of friction {_ICE:g} on a road of {_DRY:g}, at another place for each seed. The "
        "reference speed is not told. Is the patch found on the first lap, and how far from the "
        "path is the vehicle on the laps after that? The oracle is told all zones. Speeds in bends "
        "are limited to what the members' tyres transmit, except for the controller whose speed "
        "follows the friction alone.",
        tuple(
            (f"{length:g} m {where}", _with_patch(path, middle, length))
            for length in _LENGTHS
            for where, middle in (("in a bend", bend), ("on a straight", straight))
        ),
        (
            Contender(ORACLE, "oracle", TWO),
            *(believing(risk) for risk in _RISKS),
            informed(
                f"friction alone, risk {_RISKS[0]:.0%}",
                knows="nothing",
                risk=_RISKS[0],
                tyres=False,
            ),
        ),
        seeds=20,
        quick_seeds=1,
        road=moved,
    )


def moved(scenario: Scenario) -> Scenario:
    """Move the patch to a random place of the same kind, bend or straight."""
    path = build_path(scenario)
    start, end = (zone.start * path.length for zone in scenario.zones[1:])
    middle, length = 0.5 * (start + end), end - start
    kind = next(places for places in _places(path) if np.min(np.abs(places - middle)) < 1.0)
    inside = kind[(kind > length) & (kind < path.length - length)]
    rng = np.random.default_rng([scenario.seed, 7])
    return replace(scenario, zones=_zones(path, float(rng.choice(inside)), length))


def run(trial: Trial) -> IceOutcome:
    """Drive a trial."""
    path = build_path(trial.scenario)
    _, start, end = (zone.start for zone in trial.scenario.zones)
    middle = np.array([0.5 * (start + end) * path.length])
    believing = trial.scenario.speed.knows == "nothing"
    belief = new_belief(trial.scenario, path)
    medians: list[float] = []

    def observe(period: Period) -> None:
        if believing and period.truth.distance >= len(medians) * path.length:
            medians.append(float(belief.quantiles(middle, 0.5)[0]))

    controller = make(trial.contender, trial.scenario)
    found = drive(trial.scenario, controller, observe, belief)
    return IceOutcome(
        *trial.key,
        completed=found.summary.ending.completed,
        reason=found.summary.ending.reason,
        lap_errors=lap_errors(found),
        believed=tuple(medians),
        avoidable=avoidable(trial.contender, found),
    )


def lap_errors(run: Run) -> tuple[float, ...]:
    """Largest lateral error in each lap of a closed track, m."""
    last = np.ceil(run.scenario.laps) - 1.0
    lap = np.clip(run.trace.distance // run.path.length, 0.0, last)
    error = np.abs(run.trace.lateral_error)
    return tuple(float(np.max(error[lap == number])) for number in np.unique(lap))


def rows(outcomes: Sequence[IceOutcome]) -> list[tuple[str, ...]]:
    """Return a row for each contender and condition, for a table."""
    groups: dict[tuple[str, str], list[IceOutcome]] = {}
    for outcome in outcomes:
        groups.setdefault((outcome.contender, outcome.condition), []).append(outcome)
    return [_row(*key, own) for key, own in groups.items()]


def _row(contender: str, condition: str, own: Sequence[IceOutcome]) -> tuple[str, ...]:
    told = not any(o.believed for o in own)
    after = [e for o in own for e in (o.lap_errors[1:] if told else o.errors_after)]
    within = sum(error <= LARGEST_ERROR for error in after)
    return (
        contender,
        condition,
        f"{sum(o.completed for o in own)}/{len(own)}",
        str(sum(o.avoidable is True for o in own)),
        f"{np.median([o.lap_errors[0] for o in own]):.2f}",
        "-" if told else f"{sum(any(o.found[1:2]) for o in own)}",
        f"{within} of {len(after)}",
        f"{max(after):.2f}" if after else "-",
    )


HEADS: Final = (
    "contender",
    "patch",
    "completed",
    "avoidable departures",
    "lap 1: largest error, m (median)",
    "found on lap 1",
    f"laps after that within {LARGEST_ERROR:g} m",
    "largest error of these laps, m",
)


def _with_patch(path: Path, middle: float, length: float) -> Scenario:
    base = on_surfaces(CUSTOM_TRACK, ((0.0, _DRY),), 0.9)
    speed = replace(base.speed, tyres=True)
    return replace(base, zones=_zones(path, middle, length), laps=3.0, speed=speed)


def _zones(path: Path, middle: float, length: float) -> tuple[Zone, ...]:
    start, end = ((middle + side * length) / path.length for side in (-0.5, 0.5))
    return Zone(0.0, _DRY), Zone(start, _ICE), Zone(end, _DRY)


def _places(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Arc lengths, 1 m apart, in bends and on straights."""
    s = np.arange(0.0, path.length)
    curvature = np.abs(path.sample(s)[3])
    most = np.max(curvature)
    return s[curvature > _BEND * most], s[curvature < _STRAIGHT * most]
