"""What a map of other vehicles is worth on a first lap, and what a wrong one costs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import FRICTION_HYPOTHESES, merge_tiles
from egp_service.evaluation.contenders import ORACLE, make
from egp_service.evaluation.experiment import ClosedLoopExperiment
from egp_service.evaluation.unknown_roads import DRAWN, ROADS, informed
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.course import build_path
from egp_service.simulation.reference import new_belief

if TYPE_CHECKING:
    from egp_service._core import Path, RoadBelief
    from egp_service.evaluation.experiment import Trial
    from egp_service.simulation.scenario import Scenario

FLEET: Final = "fleet-roads"
ALONE: Final = "no map"
SECOND: Final = "map of one car"
THIRD: Final = "map of three cars"
WRONG: Final = "wrong map, 1.1"
OUTVOTED: Final = "wrong map, 1.1, and maps of two cars"
SLIPPERY: Final = "wrong map, 0.25"
# Cars whose first laps make the map, and the friction that one more vehicle reports everywhere.
_REPORTS: Final[dict[str, tuple[int, float | None]]] = {
    SECOND: (1, None),
    THIRD: (3, None),
    WRONG: (0, 1.1),
    OUTVOTED: (2, 1.1),
    SLIPPERY: (0, 0.25),
}
MAPS: Final = tuple(_REPORTS)
"""Names of the contenders with a map."""
_RISK: Final = 0.05
_AGE: Final = 60.0  # of all reports, s
# Evidence of a wrong map: as sharp as a cell can hold, from periods so many m apart.
_WRONG_STEP: Final = 0.25
_WRONG_LAPS: Final = 6
_WRONG_SPREAD: Final = 0.05  # of the logarithm of the friction


def first_lap_with_a_map() -> ClosedLoopExperiment:
    """Return the experiment: a first lap with different maps of the same road."""
    return ClosedLoopExperiment(
        FLEET,
        "Roads of unknown friction, first lap with a fleet's map (beyond the paper)",
        "Other cars have driven the same road before: how fast is a first lap with what they "
        "found, and what does a map cost that is wrong? The oracle is told all zones. Plans of all "
        "controllers stay within a lateral speed of 3 m/s.",
        (("first lap", ROADS),),
        (
            informed(ORACLE),
            *(informed(name, knows="nothing", risk=_RISK) for name in (ALONE, *_REPORTS)),
        ),
        seeds=20,
        quick_seeds=1,
        road=DRAWN,
    )


def reported(trial: Trial) -> RoadBelief | None:
    """Return the belief of a car that was given the trial's map; None for trials without a map.

    The cars that make the map drive with the trial's controller and risk, and with noise of their
    own.
    """
    if trial.experiment != FLEET or trial.contender.name not in _REPORTS:
        return None
    cars, wrong = _REPORTS[trial.contender.name]
    path = build_path(trial.scenario)
    maps = [_driven(trial, path, number + 1) for number in range(cars)]
    if wrong is not None:
        maps.append(_uniform(trial.scenario, path, wrong))
    belief = new_belief(trial.scenario, path)
    for index in range(belief.tiles):
        belief.report(index, merge_tiles([(other.tile(index), _AGE) for other in maps]))
    return belief


def _driven(trial: Trial, path: Path, number: int) -> RoadBelief:
    """Return what a car found on its first lap, which may end beside the road."""
    belief = new_belief(trial.scenario, path)
    scenario = _with_noise(trial.scenario, 1000 * number)
    drive(scenario, make(trial.contender, scenario), lambda _: None, belief)
    return belief


def _with_noise(scenario: Scenario, more: int) -> Scenario:
    """Return the scenario on the same track with another seed of the noise."""
    parameters = {**scenario.track.parameters, "seed": float(scenario.seed)}
    track = replace(scenario.track, parameters=parameters)
    return replace(scenario, track=track, seed=scenario.seed + more)


def _uniform(scenario: Scenario, path: Path, friction: float) -> RoadBelief:
    """Return the map of a car that reports one friction everywhere."""
    belief = new_belief(scenario, path)
    claimed = -0.5 * (np.log(np.array(FRICTION_HYPOTHESES) / friction) / _WRONG_SPREAD) ** 2
    for s in np.arange(0.0, _WRONG_LAPS * path.length, _WRONG_STEP):
        belief.update(float(s % path.length), claimed - claimed.max())
    return belief
