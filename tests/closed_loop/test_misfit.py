"""Whether a drive says that the library does not fit the vehicle."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from egp_service.cli.tables import misfit
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.scenario import Disturbances, Measurement, load_scenario
from egp_service.simulation.summary import FrictionFound

if TYPE_CHECKING:
    from egp_service.simulation.summary import Summary

NOISE = Measurement(position=0.05, v_x=0.03, psi=0.005, v_y=0.03, omega=0.005, delta=0.002)
SCENARIO = replace(load_scenario("random"), measurement=NOISE)


def summary(disturbances: Disturbances) -> Summary:
    scenario = replace(SCENARIO, disturbances=disturbances)
    with in_process_controller(scenario) as controller:
        return drive(scenario, controller, lambda _: None).summary


def test_the_vehicle_of_the_library_is_no_other_one() -> None:
    own = summary(Disturbances())
    assert own.friction is not None
    assert own.friction.misfit is not None
    assert 0.2 < own.friction.misfit < 0.8
    assert misfit(own) is None


def test_a_vehicle_that_the_members_do_not_predict_is_told() -> None:
    told = misfit(summary(Disturbances(wear_rear=0.3)))
    assert told is not None
    assert "do not predict this drive" in told


def test_a_large_misfit_is_told_after_few_periods() -> None:
    scenario = replace(SCENARIO, laps=0.05)
    with in_process_controller(scenario) as controller:
        trace = drive(scenario, controller, lambda _: None).trace
    for misfit_of_window, periods, found in ((30.0, 10, 30.0), (30.0, 9, None), (19.0, 10, None)):
        windows = np.full(len(trace), np.nan)
        windows[:periods] = misfit_of_window
        assert FrictionFound.of(replace(trace, misfit=windows)).misfit == found
