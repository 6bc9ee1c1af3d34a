"""Why a run that the gate stopped has ended."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from egp_service import Controller
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.scenario import (
    Scenario,
    Speed,
    Track,
    Zone,
    gate_settings,
    library_path,
    load_scenario,
    told_zones,
)

if TYPE_CHECKING:
    from egp_service._core import Decision
    from egp_service.control.step import Measured

SCENARIO = told_zones(load_scenario("rounded-rectangle"))
OUT = 20  # the period without a measurement


class Dropout(Controller):
    """Has no measurement in one period."""

    periods = 0

    def _decide(self, start: float, budget: float, measured: Measured) -> Decision:
        self.periods += 1
        x, *others = measured
        x = np.full(7, np.nan) if self.periods == OUT else x
        return super()._decide(start, budget, (x, *others))  # type: ignore[arg-type]


def test_the_reason_is_that_for_which_the_stop_began() -> None:
    scenario = replace(SCENARIO, leave_distance=50.0)
    with Dropout(library_path(scenario), gate=gate_settings(scenario)) as controller:
        run = drive(scenario, controller, lambda _: None)
    stopping = run.trace.mode == "stop"
    assert np.flatnonzero(stopping)[0] == OUT - 1
    assert run.trace.status[-1] == "solved"
    assert run.summary.ending.reason == f"stopped by the gate: {run.trace.detail[OUT - 1]}"
    assert "NaN" in run.summary.ending.reason


def test_a_car_that_leaves_is_told_what_was_judged() -> None:
    speed = Speed(constant=True, v_max=20.0)
    wide = Track("circle", parameters={"radius": 40.0, "track_width": 100.0})
    scenario = Scenario("wide", wide, (Zone(0.0, 0.1),), leave_distance=2.0, speed=speed)
    with in_process_controller(scenario) as controller:
        run = drive(scenario, controller, lambda _: None)
    assert not run.summary.ending.completed
    last = run.trace.lateral_error[-1]
    assert 2.0 < abs(last) < 2.5
    assert run.summary.ending.reason == f"more than 2 m beside the path: {last:+.2f} m"
