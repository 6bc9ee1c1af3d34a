"""The tables that commands print fit a terminal of 80 columns, with their words in one piece."""

from __future__ import annotations

import io
import re
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from egp_service import shipped
from egp_service.cli import app
from egp_service.cli.inspect_library import inspect
from egp_service.cli.tables import (
    calibration_warnings,
    delay_sentence,
    headline_table,
    no_plan,
    prior_warnings,
    skill_table,
    summary_table,
    validation_table,
    vehicle_table,
)
from egp_service.data.alignment import Delays
from egp_service.data.dataset import Dataset
from egp_service.data.provenance import Provenance
from egp_service.evaluation import baselines
from egp_service.evaluation.experiments import EXPERIMENTS
from egp_service.evaluation.logs import OURS, PAPER, VEHICLE
from egp_service.evaluation.summary_report import HEADLINE
from egp_service.simulation.summary import Ending, Error, Summary
from egp_service.training.open_loop import LINEAR, NO_CHANGE, Skill, skill
from egp_service.training.validation import Cell
from egp_service.training.vehicle_fit import FittedParameter, FittedVehicle
from egp_service.training.vehicle_priors import PARAMETERS
from library_example import write_example

if TYPE_CHECKING:
    from pathlib import Path

    from rich.table import Table

SURFACES = ("friction 0.5", "friction 0.8", "friction 1.1")


def printed(*tables: Table, width: int = 80) -> list[str]:
    """Print tables as a terminal of some width shows them."""
    console = Console(file=io.StringIO(), width=width)
    console.print(*tables)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def check(lines: list[str]) -> None:
    """Assert that lines fit and that no cell is cut off."""
    assert len(lines) > 3
    assert max(map(len, lines)) <= 80
    assert "…" not in "".join(lines)


def check_table(table: Table) -> None:
    """Assert that a table fits, and that all of its words are in one piece."""
    lines = printed(table)
    check(lines)
    words = Counter(" ".join(printed(table, width=400)).split())
    words -= Counter(" ".join(lines).split())
    assert not [word for word in words if not word.startswith("─")], "\n".join(lines)


def summary(
    reason: str = "completed", p99: float = 65.4, refused: int = 0, p50: float = 12.3
) -> Summary:
    """Return a summary of a long and slow run."""
    ending = Ending(reason == "completed", reason, 987.6, 23456.7, (0.0, 0.0))
    times = {"p50": p50, "p90": 25.6, "p99": p99, "max": 200.0}
    return Summary(
        scenario="rounded-rectangle",
        library="",
        members=SURFACES,
        ending=ending,
        periods=10_000,
        dt=0.02,
        lateral_error=Error(3.45, 1.23),
        speed_error=Error(6.54, 3.21),
        mean_speed=22.2,
        step_time_ms=times,
        deadline_misses=123,
        tail_ticks=0,
        stop_ticks=0,
        solver_statuses={"late": 5000, "solved": 5000 - refused, "refused": refused},
        no_plan_reasons={"late: no answer": 5000, "refused: no seal": refused},
    )


def test_summaries_of_runs_fit() -> None:
    left = "left the track: 3.21 m from the path"
    rows = [("rounded-rectangle", summary()), ("told, μ 1.1", summary(left))]
    check_table(summary_table(rows))
    # Where the numbers need more columns, the name of the run has fewer.
    lines = printed(summary_table([("rounded-rectangle", summary(p99=1234.5))]))
    check(lines)
    assert re.search(r"12\.3/1234\.5 +123\b", "".join(lines))


def test_times_of_fast_steps_are_told_apart() -> None:
    lines = printed(summary_table([("lap", summary(p50=0.2136, p99=1.2345))]))
    assert "0.214/1.2 " in "".join(lines)


def test_a_run_whose_most_periods_had_no_plan_says_why() -> None:
    assert no_plan(summary()) is None
    assert no_plan(summary(refused=1)) == "No plan in 5001 of 10000 periods: late: no answer"


def test_validation_of_a_library_fits() -> None:
    values = np.array([0.1234, 12.3456, 0.0123])
    cells = [
        [Cell(member, surface, values, -10.0 * values, values, 10.0 * values)
         for surface in SURFACES] for member in SURFACES
    ]  # fmt: skip
    check_table(validation_table(cells))


def test_badly_calibrated_members_and_parameters_far_from_the_prior_are_named() -> None:
    other, zeros = np.zeros(3), np.zeros(3)
    for coverage, expected in ((0.81, 0), (0.79, 1)):
        own = np.array([0.95, coverage, 0.95])
        cells = [Cell("wet", surface, zeros, zeros, covered, zeros)
                 for surface, covered in (("wet", own), ("dry", other))]  # fmt: skip
        warnings = calibration_warnings([cells], simulated=False)
        assert len(warnings) == expected
    assert warnings[0].endswith("collect more data, or check the units of the log")
    assert calibration_warnings([cells], simulated=True)[0].endswith("; collect more data")
    assert warnings[0].startswith("wet: the 95 % interval of d_v_y holds 79% of the held-out data")
    assert "too narrow; collect more data" in warnings[0]
    near, far = (
        FittedParameter(name, 1.0, 0.9, 1.1, distance, determined=True, at_bound=False)
        for name, distance in (("m", 2.9), ("l_f", -3.1))
    )
    assert prior_warnings("wet", FittedVehicle((near,)).summary(), simulated=False) == []
    both = FittedVehicle((near, far)).summary()
    (warning,) = prior_warnings("wet", both, simulated=False)
    assert "from the prior: l_f (-3.1); check the units" in warning
    assert "can be the error of the single-track equations" in warning
    (warning,) = prior_warnings("wet", both, simulated=True)
    assert "l_f (-3.1); the simulated car is no single-track vehicle" in warning
    assert "units" not in warning
    height = {"h": dict(both[next(iter(both))], distance=-5.4)}
    (warning,) = prior_warnings("wet", height, simulated=False)
    assert "no file states the height" in warning
    assert "units" not in warning


@pytest.mark.parametrize("determined", [False, True])
def test_a_fitted_vehicle_fits(determined: bool) -> None:  # noqa: FBT001
    parameters = [
        FittedParameter(name, 1234.5678, 1.234e-5, 4321.0, -12.3, determined, at_bound=True)
        for name in PARAMETERS
    ]
    parameters[0] = replace(parameters[0], determined=False, assumed=determined)
    table = vehicle_table("friction 0.5", FittedVehicle(tuple(parameters)).summary())
    check_table(table)
    # The terminal breaks the lines of the caption where the table ends.
    assert "\n" not in str(table.caption)
    shown = " ".join(" ".join(printed(table)).split())
    assert ("scales with the mass" in shown) == determined
    assert "c_0: rolling resistance" in shown
    level = FittedVehicle(tuple(parameters[:-2]))
    assert "c_0" not in str(vehicle_table("friction 0.5", level.summary()).caption)
    # The mass that the import assumed is not determined, either.
    assert shown.count("not determined") == (1 if determined else len(PARAMETERS))


def test_skill_on_a_log_fits() -> None:
    names = (NO_CHANGE, OURS, PAPER, VEHICLE, LINEAR, f"member of {SURFACES[0]}", "wet [/x]")
    rms = {name: np.full((5, 3), 10.0 + k) for k, name in enumerate(names)}
    likelihood = dict.fromkeys(names, -12.345)
    table = skill_table(SURFACES[0], Skill((0.04, 0.2, 0.5, 1.0, 2.0), rms, likelihood, 5.0))
    check_table(table)


def test_skill_without_a_duration_has_a_row_for_each_output() -> None:
    z, steps = np.zeros((4, 6)), np.arange(4, dtype=np.uint32)
    origin = Provenance(0.02, "toy", "dry", 1.0, 0, "formula", "test")
    standing = Dataset(z, np.zeros((4, 3)), steps, steps, origin)
    compared = skill({OURS: lambda z: z[:, :3]}, standing)
    assert compared.rms[OURS].shape == (0, 3)
    lines = printed(skill_table(SURFACES[0], compared))
    check(lines)
    assert [sum(name in line for line in lines) for name in ("v_x", "v_y", "omega")] == [2, 2, 2]


def test_a_log_without_delays_is_described() -> None:
    assert delay_sentence(Delays()).startswith("no delay of the log is known")


def test_the_best_controllers_of_all_experiments_fit() -> None:
    cell = "20/20, 0.022 m"
    rows = [
        (experiment.name, condition, cell, f"{cell} fitted single-track", cell)
        for experiment in EXPERIMENTS
        for condition, _ in experiment.conditions
    ]
    check_table(headline_table(HEADLINE, rows))


def test_the_content_of_libraries_fits(tmp_path: Path) -> None:
    example = tmp_path / "library.safetensors"
    noise = np.array([0.0071, 0.0017, 0.0008])
    write_example(example, measurement_noise=noise, measurement_delay=0.056)
    for path in (example, shipped.DEMO_LIBRARY):
        console = Console(file=io.StringIO(), width=80)
        inspect(path, console)
        assert isinstance(console.file, io.StringIO)
        check(console.file.getvalue().splitlines())


@pytest.mark.parametrize("columns", [40, 60])
def test_a_narrow_terminal_shows_all_of_a_library(tmp_path: Path, columns: int) -> None:
    axles = tmp_path / "axles.safetensors"
    baselines.write(axles, "single-track", shipped.DEMO_LIBRARY, [0, 1], 1)
    for path in (axles, shipped.DEMO_LIBRARY):
        wide, narrow = (io.StringIO() for _ in range(2))
        inspect(path, Console(file=wide, width=400))
        inspect(path, Console(file=narrow, width=columns))
        assert "…" not in narrow.getvalue()
        # The lines of the properties above the tables may break within a number.
        tables = (shown.getvalue().partition("Surfaces")[2] for shown in (wide, narrow))
        in_wide, in_narrow = (Counter(re.findall(r"[-+.\de]*\d", text)) for text in tables)
        # Rows that become paragraphs repeat the heads of their columns.
        assert in_wide <= in_narrow
        assert set(in_narrow) == set(in_wide)


def test_a_narrow_terminal_shows_rows_as_paragraphs() -> None:
    lines = printed(summary_table([("rounded-rectangle", summary())]), width=30)
    assert "  result: completed" in map(str.rstrip, lines)
    assert "12.3/65.4" in " ".join(lines)
    assert "…" not in "".join(lines)
    told = CliRunner().invoke(app, ["settings", "lateral"], env={"COLUMNS": "40"}).output
    assert "cost.lateral" in told
    assert "  unit: 1/m²" in told


def test_brackets_in_names_are_shown() -> None:
    skill = Skill((), {NO_CHANGE: np.zeros((0, 3))}, {NO_CHANGE: 0.0}, 5.0)
    for table in (summary_table([("a [/b]", summary())]), skill_table("a [/b]", skill)):
        assert "a [/b]" in " ".join(printed(table))


@pytest.mark.parametrize("command", ["settings", "doctor"])
def test_settings_and_the_state_of_the_machine_fit(command: str) -> None:
    check(CliRunner().invoke(app, [command], env={"COLUMNS": "80"}).output.splitlines())
