"""Runs and recordings as values: what is equal, and what is printed."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import egp_service
from egp_service.control.recorded import read_recording
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.runs import record_run
from egp_service.simulation.scenario import load_scenario

if TYPE_CHECKING:
    from pathlib import Path

    from egp_service.simulation.closed_loop import Run
    from egp_service.simulation.trace import Period

SCENARIO = replace(load_scenario("rounded-rectangle"), laps=0.05)


def driven() -> tuple[Run, list[Period]]:
    periods: list[Period] = []
    with in_process_controller(SCENARIO) as controller:
        return drive(SCENARIO, controller, observe=periods.append), periods


def test_runs_of_a_scenario_are_equal_but_for_the_times() -> None:
    (one, first), (other, second) = driven(), driven()
    assert one == other == copy.deepcopy(one)
    assert one.trace == other.trace
    assert one.trace != replace(other.trace, u=other.trace.u + 1e-9)
    assert first[3].truth == second[3].truth
    assert first[3].truth != second[4].truth


def test_runs_and_recordings_are_printed_in_a_line(tmp_path: Path) -> None:
    with in_process_controller(SCENARIO) as controller:
        run = record_run(SCENARIO, controller, tmp_path, lambda _: None)
    count = len(run.trace)
    assert repr(run.trace) == f"<Trace of {count} periods>"
    seconds = f"{run.summary.ending.time:g}"
    expected = f"<Run of rounded-rectangle: completed after {seconds} s, {count} periods of 0.02 s>"
    assert repr(run) == expected
    recorded = read_recording(tmp_path / "run.mcap")
    described = f"mu 0.5, mu 1.1: dt 0.02 s, horizon 40, {count} steps"
    assert repr(recorded) == f"<Recorded of {described}>"
    step = recorded.steps[1]
    assert step.reply is not None
    sizes = f"request of {len(step.request)} bytes, reply of {len(step.reply)} bytes"
    assert repr(step) == f"<RecordedStep at 0.02 s: {sizes}>"


def test_the_package_states_its_version() -> None:
    assert egp_service.__version__ == "0.1.0"
