"""The highest speed at which a contender comes through the cones of ISO 3888-2, by bisection.

The car enters at a speed that its reference keeps throughout; the standard lets it coast, so speeds
here are lower than those of a test report. It comes through when it completes the course and the
sides of its middle stay inside the cones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from egp_service.evaluation.campaign import drive_trial, off_track
from egp_service.simulation.scenario import Speed

if TYPE_CHECKING:
    from collections.abc import Callable

    from egp_service.evaluation.experiments import Trial

SLOWEST: Final = 7.0  # m/s
RESOLUTION: Final = 0.25
_SPEEDS: Final = 63  # of the grid, up to 22.5 m/s, where even mu 1.1 falls short; six runs


@dataclass(frozen=True, slots=True)
class EntrySpeed:
    """What one contender survives on one surface with one seed."""

    experiment: str
    condition: str
    contender: str
    seed: int
    speed: float
    """Highest one survived of a grid of `RESOLUTION`, m/s; 0 when not even `SLOWEST` is."""


def find(trial: Trial) -> EntrySpeed:
    """Bisect the entry speed of a trial, whose own speed does not matter."""

    def survives(speed: float) -> bool:
        scenario = replace(trial.scenario, speed=Speed(v_max=speed, constant=True))
        run = drive_trial(replace(trial, scenario=scenario))
        return run.summary.ending.completed and off_track(scenario, run) == 0.0

    return EntrySpeed(*trial.key, speed=highest(survives))


def highest(survives: Callable[[float], bool]) -> float:
    """Highest speed that is survived, if whoever survives one also survives all below it."""
    survived, failed = -1, _SPEEDS
    while failed - survived > 1:
        middle = (survived + failed) // 2
        if survives(SLOWEST + RESOLUTION * middle):
            survived = middle
        else:
            failed = middle
    return 0.0 if survived < 0 else SLOWEST + RESOLUTION * survived
