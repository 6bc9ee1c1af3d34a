"""The highest speed at which a contender passes the cones of ISO 3888-2, by bisection.

The reference speed is constant, whereas the standard lets the car coast; speeds here are therefore
lower than those of test reports. A run passes if it completes the course and the sides of the car,
measured at its centre of mass, stay between the cones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from egp_service.evaluation.campaign import drive_trial, off_track
from egp_service.simulation.scenario import Speed

if TYPE_CHECKING:
    from collections.abc import Callable

    from egp_service.evaluation.experiment import Trial

SLOWEST: Final = 7.0  # m/s
RESOLUTION: Final = 0.25
_SPEEDS: Final = 63  # grid up to 22.5 m/s, too fast even for mu 1.1; bisection takes six runs


@dataclass(frozen=True, slots=True)
class EntrySpeed:
    """Result of one contender on one surface with one seed."""

    experiment: str
    condition: str
    contender: str
    seed: int
    speed: float
    """Highest passed speed on a grid of `RESOLUTION`, m/s; 0 if `SLOWEST` is not passed."""


def find(trial: Trial) -> EntrySpeed:
    """Bisect the entry speed of a trial; the trial's own speed is ignored."""

    def passes(speed: float) -> bool:
        scenario = replace(trial.scenario, speed=Speed(v_max=speed, constant=True))
        run = drive_trial(replace(trial, scenario=scenario))
        return run.summary.ending.completed and off_track(scenario, run) == 0.0

    return EntrySpeed(*trial.key, speed=highest(passes))


def highest(passes: Callable[[float], bool]) -> float:
    """Return the highest passed speed, assuming that all lower speeds are passed, too."""
    passed, failed = -1, _SPEEDS
    while failed - passed > 1:
        middle = (passed + failed) // 2
        if passes(SLOWEST + RESOLUTION * middle):
            passed = middle
        else:
            failed = middle
    return 0.0 if passed < 0 else SLOWEST + RESOLUTION * passed
