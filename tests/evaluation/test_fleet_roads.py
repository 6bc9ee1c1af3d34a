"""The maps of the experiment *fleet-roads*."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from egp_service import VehicleParameters
from egp_service.control.toml_text import dumps
from egp_service.evaluation import fleet_roads
from egp_service.evaluation.contenders import ORACLE
from egp_service.simulation.course import build_path, road_name
from egp_service.simulation.reference import new_belief

if TYPE_CHECKING:
    from pathlib import Path

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


def test_the_maps_have_the_scale_of_the_vehicle(tmp_path: Path) -> None:
    small = VehicleParameters.commonroad(1).fields()
    small |= {"l_f": 0.16, "l_r": 0.17, "width": 0.2, "mass": 3.7, "yaw_inertia": 0.1}
    (tmp_path / "small.toml").write_text(dumps(small))
    trial = TRIALS[fleet_roads.WRONG]
    scenario = replace(trial.scenario, vehicle_file=str(tmp_path / "small.toml"))
    belief = fleet_roads.reported(replace(trial, scenario=scenario))
    assert belief is not None
    assert belief.scale == new_belief(scenario, build_path(scenario)).scale == 0.125


def test_other_cars_drive_on_the_same_road() -> None:
    scenario = TRIALS[fleet_roads.SECOND].scenario
    other = fleet_roads._with_noise(scenario, 1000)  # noqa: SLF001
    assert other.seed == scenario.seed + 1000
    assert road_name(other) == road_name(scenario)
    assert build_path(other).length == build_path(scenario).length
