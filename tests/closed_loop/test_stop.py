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
    from numpy.typing import ArrayLike

    from egp_service import Step

SCENARIO = told_zones(load_scenario("rounded-rectangle"))
OUT = 20  # the period without a measurement


class Dropout(Controller):
    """Has no measurement in one period."""

    periods = 0

    def step(
        self,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        *,
        road_friction: ArrayLike | None = None,
        deadline: float | None = None,
    ) -> Step:
        """Return the step."""
        self.periods += 1
        x = np.full(7, np.nan) if self.periods == OUT else x
        return super().step(x, reference, widths, road_friction=road_friction, deadline=deadline)


def test_the_reason_is_that_for_which_the_stop_began() -> None:
    scenario = replace(SCENARIO, leave_distance=50.0)
    with Dropout(library_path(scenario), gate=gate_settings(scenario)) as controller:
        run = drive(scenario, controller, lambda _: None)
    stopping = run.trace.mode == "stop"
    assert np.flatnonzero(stopping)[0] == OUT - 1
    assert run.trace.status[-1] == "solved"
    assert run.summary.ending.reason == f"stopped by the gate: {run.trace.detail[OUT - 1]}"
    assert "NaN" in run.summary.ending.reason
