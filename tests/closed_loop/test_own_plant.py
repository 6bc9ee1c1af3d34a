"""A user's simulator in the closed loop: that of docs/simulator.md, and what others lack."""

from __future__ import annotations

import csv
import io
import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import Mock

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from egp_service._core import VehicleParameters
from egp_service.cli import app, evaluation_parts
from egp_service.cli.commands.evaluate import _campaign, _on_plant
from egp_service.cli.evaluation_parts import Selection
from egp_service.cli.options import NOT_COMPLETED
from egp_service.evaluation import experiments
from egp_service.evaluation.batch import finish
from egp_service.evaluation.campaign import Campaign, Outcome
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE, Contender
from egp_service.evaluation.experiment import Trial
from egp_service.shipped import DEMO_LIBRARY, EVALUATION_LIBRARY
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.plant import PlantError, load_simulator
from egp_service.simulation.report import draw_comparison, draw_run
from egp_service.simulation.runs import record_run
from egp_service.simulation.scenario import (
    Disturbances,
    Scenario,
    Zone,
    load_scenario,
    parse_scenario,
)
from egp_service.simulation.scenario_checks import ScenarioError
from fewer_contenders import with_contenders
from rails import rails_car

if TYPE_CHECKING:
    from numpy.typing import NDArray

DOCUMENT = Path(__file__).parents[2] / "docs/simulator.md"
BROKEN = """
class Short:
    state = [0.0, 0.0]
    def reset(self, x): pass
    def step(self, u, dt, friction): pass

class Lost(Short):
    state = [float("nan")] * 7

class Method(Short):
    def state(self): return [0.0] * 7

class Text(Short):
    state = "fast"

class Complex(Short):
    state = [1j] * 7

class Empty:
    pass

class Slots:
    __slots__ = ("state",)
    def reset(self, x): self.state = x
    def step(self, u, dt, friction): self.state = [float("nan")] * 7

class Compiled(Short):
    __slots__ = ()
    def __getattribute__(self, name):
        if name == "__dict__":
            raise AttributeError(name)
        return object.__getattribute__(self, name)

class Licensed:
    def __init__(self): raise ValueError("no licence")

class Failing(Slots):
    __slots__ = ()
    def step(self, u, dt, friction): raise ZeroDivisionError("solver diverged")

class Writing(Slots):
    __slots__ = ()
    def step(self, u, dt, friction):
        u[:] = 0.123
        p_x, p_y, *rest = self.state
        self.state = [p_x + rest[0] * dt, p_y, *rest]

class Far(Slots):
    __slots__ = ()
    def step(self, u, dt, friction): self.state = [1e8, *self.state[1:]]

class Backwards(Slots):
    __slots__ = ()
    def step(self, u, dt, friction):
        p_x, p_y, *rest = self.state
        self.state = [p_x - 0.1, p_y + 1.0, *rest]
"""
# A vehicle without slip, of the shipped libraries' mass and axle distance.
ON_RAILS = rails_car("Car", 1225.9, 2.578)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in ("drift_car", "broken_car"):
        sys.modules.pop(name, None)
    (tmp_path / "broken_car.py").write_text(BROKEN)
    return tmp_path


def scenario() -> Scenario:
    return load_scenario("rounded-rectangle")


def test_the_documents_simulator_is_driven(folder: Path) -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    (code,) = re.findall(r'```python title="drift_car.py"\n(.*?)```', text, re.DOTALL)
    (folder / "drift_car.py").write_text(code)
    own = replace(scenario(), plant="drift_car:DriftCar", laps=0.15)
    (folder / "own.toml").write_text(own.toml())
    command = ["drive", "-s", "own.toml", "--in-process", "--no-pictures", "-o", "runs"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    (run,) = (folder / "runs").iterdir()
    summary = (run / "summary.json").read_text()
    # Measured on the whole lap: 0.009 m, with a library that was trained on the built-in car.
    assert float(re.findall(r'"lateral_error": {\s+"max": ([\d.]+)', summary)[0]) < 0.05


def test_a_disturbance_that_a_simulator_does_not_see_is_an_error_before_the_run(
    folder: Path,
) -> None:
    loaded = replace(scenario(), disturbances=Disturbances(load=100.0), library=str(DEMO_LIBRARY))
    (folder / "loaded.toml").write_text(loaded.toml())
    command = ["drive", "-s", "loaded.toml", "--in-process", "-o", "runs"]
    failed = CliRunner().invoke(app, [*command, "--plant", "broken_car:Slots"]).exception
    assert str(failed) == "loaded.toml: disturbances have no effect on plant 'broken_car:Slots'"
    assert not (folder / "runs").exists()


@pytest.mark.parametrize(
    ("zone", "message"),
    [
        (Zone(0.5, 0.8, right=0.3), "zones[1] has two sides, but {}: leave out the right one"),
        (
            Zone(0.5, surface="snow"),
            "zones[1].surface is a tyre's force over slip, but {}: state friction = 0.3 instead",
        ),
    ],
)
def test_a_road_that_a_simulator_does_not_see_is_an_error_before_the_run(
    folder: Path, zone: Zone, message: str
) -> None:
    name = "broken_car:Writing"
    own = replace(scenario(), zones=(Zone(0.0, 0.8), zone), library=str(DEMO_LIBRARY))
    (folder / "own.toml").write_text(own.toml())
    command = ["drive", "-s", "own.toml", "--in-process", "-o", "runs", "--plant", name]
    failed = CliRunner().invoke(app, command).exception
    told = message.format(f"{name} is told one friction coefficient")
    assert str(failed) == f"own.toml: {told}"
    assert not (folder / "runs").exists()
    own = replace(own, plant=name)
    with in_process_controller(own) as controller, pytest.raises(ScenarioError, match="told one"):
        drive(own, controller, lambda _: None)


def test_what_is_wrong_with_a_simulator_is_named(folder: Path) -> None:
    (folder / "half_car.py").write_text("class Car\n")
    for name, message in {
        "broken_car": "expected MODULE:CLASS",
        "no_such_module:Car": f"No module named .*looked in {folder} and the installed pack",
        "broken_car.py:Slots": "the name of a module, not of its file: broken_car:Slots$",
        "./cars/own.py:Car": "the name of a module, not of its file: cars.own:Car$",
        "broken_car:Car": "no attribute 'Car'",
        "broken_car:Empty": "has no reset, step, state",
        "broken_car:Licensed": "cannot be made: ValueError: no licence .*broken_car.py, line",
        "half_car:Car": "SyntaxError: expected ':' .half_car.py, line 1.$",
    }.items():
        with pytest.raises(PlantError, match=message):
            load_simulator(name)
    own = replace(scenario(), plant="broken_car:Failing")
    failed = "broken_car:Failing.step: ZeroDivisionError: solver diverged .*broken_car.py, line"
    with in_process_controller(own) as controller, pytest.raises(PlantError, match=failed):
        drive(own, controller, lambda _: None)
    own = replace(scenario(), plant="broken_car:Short")
    with in_process_controller(own) as controller:
        with pytest.raises(PlantError, match=r"shape \(2,\): expected \(7,\)"):
            drive(own, controller, lambda _: None)
        with pytest.raises(ScenarioError, match="disturbances have no effect"):
            parse_scenario(own.toml().replace("load = 0.0", "load = 100.0"), Path(), "own.toml")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Lost", r"state after reset is \[nan"),
        ("Method", "state is a method: make it a property"),
        ("Text", "state is no array of seven numbers"),
        ("Complex", "state is no array of seven numbers"),
    ],
)
def test_states_that_are_none_are_named(folder: Path, name: str, message: str) -> None:
    del folder
    own = replace(scenario(), plant=f"broken_car:{name}")
    with in_process_controller(own) as controller, pytest.raises(PlantError, match=message):
        drive(own, controller, lambda _: None)


@pytest.mark.parametrize("name", ["Slots", "Compiled"])
def test_a_simulator_needs_no_dictionary(folder: Path, name: str) -> None:
    del folder
    load_simulator(f"broken_car:{name}")


@pytest.mark.parametrize("name", ["Slots", "Backwards"])
def test_a_run_that_ends_at_its_start_or_behind_it_has_pictures(folder: Path, name: str) -> None:
    own = replace(scenario(), plant=f"broken_car:{name}")
    with in_process_controller(own) as controller:
        run = drive(own, controller, lambda _: None)
    assert run.trace.distance[-1] <= 0.0
    for picture in [*draw_run(run, folder), draw_comparison([("a", run)], folder / "c.png")]:
        assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("command", ["drive", "evaluate"])
def test_the_help_says_what_a_simulator_needs(command: str) -> None:
    text = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "80"}).output
    for needed in ("reset(x)", "step(u, dt, friction)", "state", "docs/simulator.md"):
        assert needed in text


def test_the_evaluation_drives_a_simulator_of_ones_own(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fewer = [
        replace(with_contenders(e, ENSEMBLE, ORACLE), quick_seeds=1)
        if e.name == "lane-change"
        else e
        for e in experiments.EXPERIMENTS
    ]
    monkeypatch.setattr(experiments, "EXPERIMENTS", tuple(fewer))
    (folder / "rails_car.py").write_text(ON_RAILS)
    command = ["evaluate", "-e", "lane-change", "--plant", "rails_car:Car", "-o", "out"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    # The runs are driven in other processes.
    assert sys.modules["rails_car"].Car.made == 1
    rows = list(csv.DictReader((folder / "out/runs.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 2
    assert {row["completed"] for row in rows} == {"True"}
    # A car that never slides follows the path on every surface, whatever the contender believes.
    errors = [float(row["lateral_rms"]) for row in rows]
    assert max(errors) < 0.05
    missing = CliRunner().invoke(app, ["evaluate", "-e", "lane-change", "--plant", "rails_car:Van"])
    assert isinstance(missing.exception, PlantError)
    disturbed = CliRunner().invoke(app, [*command, "-e", "disturbances"])
    assert "without --plant" in str(disturbed.exception)


def test_a_simulator_that_writes_into_its_input_changes_no_record(folder: Path) -> None:
    del folder
    own = replace(scenario(), plant="broken_car:Writing", laps=0.01)
    commands: list[NDArray[np.float64]] = []
    with in_process_controller(own) as controller:
        run = drive(own, controller, lambda period: commands.append(period.step.u.copy()))
    assert np.array_equal(run.trace.u, commands)
    assert not (run.trace.u == 0.123).any()


@pytest.mark.parametrize(
    ("name", "message"), [("Slots", "is not finite: [nan"), ("Far", "has a number beyond ±1e+07:")]
)
def test_a_drive_says_which_state_of_a_simulator_ended_it(
    folder: Path, name: str, message: str
) -> None:
    command = ["drive", "--plant", f"broken_car:{name}", "--in-process", "--no-pictures"]
    result = CliRunner().invoke(app, [*command, "-o", str(folder / "runs")])
    assert result.exit_code == NOT_COMPLETED
    told = f"The run ended early. Lost control: broken_car:{name}.state after step {message}"
    assert told in " ".join(result.output.split())


def test_the_summary_of_a_state_that_is_no_number_is_json(folder: Path) -> None:
    own = replace(scenario(), plant="broken_car:Slots")
    with in_process_controller(own) as controller:
        run = record_run(own, controller, folder, lambda _: None)
    assert "nan" in run.summary.ending.reason

    def refuse(number: str) -> None:
        raise AssertionError(number)

    summary = json.loads((folder / "summary.json").read_text(), parse_constant=refuse)
    assert summary["ending"]["position"] == run.trace.x[-1, :2].tolist()


def test_conditions_that_a_simulator_does_not_see_are_left_out(folder: Path) -> None:
    del folder
    (hard,) = (e for e in experiments.EXPERIMENTS if e.name == "hard-roads")
    left = {"vehicle 2", "split 1.1 | 0.5 for a third", "split 1.1 | 0.5, 75% of grip"}
    own = experiments.on_plant(hard, "a:B", VehicleParameters.commonroad(1), Path("vehicle.toml"))
    names = [name for name, _ in hard.conditions]
    assert [name for name, _ in own.conditions] == [name for name in names if name not in left]
    assert all(one.plant == "a:B" for _, one in own.conditions)
    console = Console(file=io.StringIO(), width=1000)
    chosen = Selection(full=False, chosen=["hard-roads"], driven=[hard], apart=[])
    selected = _on_plant(console, chosen, "broken_car:Slots", None, EVALUATION_LIBRARY, Path("out"))
    assert selected.driven[0].conditions[0][1].plant is not None
    assert isinstance(console.file, io.StringIO)
    told = console.file.getvalue()
    assert told.startswith("hard-roads without the conditions that")
    assert all(name in told for name in left)
    text = CliRunner().invoke(app, ["evaluate", "--help"], env={"COLUMNS": "80"}).output
    assert "experiment prediction uses the built-in vehicle" in " ".join(text.split())


def test_runs_of_a_simulator_that_was_changed_are_told(folder: Path) -> None:
    nothing = Selection(full=False, chosen=[], driven=[], apart=[])

    def told(plant: str | None) -> str:
        file = io.StringIO()
        console = Console(file=file, width=1000)
        _campaign(console, nothing, folder / "out", DEMO_LIBRARY, plant, None, None)
        return file.getvalue()

    load_simulator("broken_car:Slots")
    assert [told(plant) for plant in ("broken_car:Slots", None, "broken_car:Slots")] == [""] * 3
    (folder / "broken_car.py").write_text(f"{BROKEN}\n")
    text = told("broken_car:Slots")
    assert "runs of another version of the file of broken_car:Slots, which are kept." in text
    assert "Choose another --output" in text
    assert not told(None)


def test_an_evaluation_that_a_simulator_ends_keeps_what_is_done(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "rails_car.py").write_text(ON_RAILS)
    short = replace(scenario(), laps=0.01, library=str(DEMO_LIBRARY))
    trials = [
        Trial("short", plant, Contender(ENSEMBLE, "ensemble", (0, 1)), replace(short, plant=plant))
        for plant in ("rails_car:Car", "broken_car:Failing")
    ]
    campaign = Campaign(folder / "out", DEMO_LIBRARY)
    done: list[Outcome] = []
    with pytest.raises(PlantError, match="solver diverged") as caught:
        finish([campaign.runs(trials, done.append)], 1)
    assert caught.value.__notes__ == ["in short, broken_car:Failing, ensemble, seed 0"]
    assert [outcome.condition for outcome in done] == ["rails_car:Car"]
    # The command says that it can be continued.
    monkeypatch.setattr(evaluation_parts, "finish", Mock(side_effect=caught.value))
    console = Console(file=io.StringIO())
    nothing = Selection(full=False, chosen=[], driven=[], apart=[])
    with pytest.raises(PlantError):
        evaluation_parts.run(console, Mock(), nothing, folder, jobs=None, cluster=None)
    assert isinstance(console.file, io.StringIO)
    assert "The same command continues" in console.file.getvalue()
