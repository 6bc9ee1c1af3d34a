"""The maps of the experiment *fleet-roads*."""

from __future__ import annotations

import numpy as np
import pytest

from egp_service.evaluation import fleet_roads
from egp_service.evaluation.contenders import ORACLE
from egp_service.simulation.course import build_path, road_name

EXPERIMENT = fleet_roads.first_lap_with_a_map()
TRIALS = {trial.contender.name: trial for trial in EXPERIMENT.trials([3])}


def test_only_trials_with_a_map_have_reports() -> None:
    assert fleet_roads.reported(TRIALS[ORACLE]) is None
    assert fleet_roads.reported(TRIALS[fleet_roads.ALONE]) is None


@pytest.mark.parametrize(("name", "said"), [(fleet_roads.WRONG, 1.1), (fleet_roads.SLIPPERY, 0.25)])
def test_a_wrong_map_states_one_friction_everywhere(name: str, said: float) -> None:
    belief = fleet_roads.reported(TRIALS[name])
    assert belief is not None
    assert belief.trust == pytest.approx(0.5)
    places = np.linspace(0.0, build_path(TRIALS[name].scenario).length, 40)
    assert belief.quantiles(places, 0.5) == pytest.approx(np.full(40, said), rel=0.1)


def test_other_cars_drive_on_the_same_road() -> None:
    scenario = TRIALS[fleet_roads.SECOND].scenario
    other = fleet_roads._with_noise(scenario, 1000)  # noqa: SLF001
    assert other.seed == scenario.seed + 1000
    assert road_name(other) == road_name(scenario)
    assert build_path(other).length == build_path(scenario).length
