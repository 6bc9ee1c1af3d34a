"""Why a run that the gate stopped has ended."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from egp_service import Controller
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.scenario import (
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
