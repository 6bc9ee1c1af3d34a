"""Where the module of a simulator is looked for."""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from egp_service.cli import app
from egp_service.cli.options import NOT_COMPLETED
from egp_service.simulation.plant import PlantError, load_simulator
from egp_service.simulation.scenario import load_scenario, parse_scenario
from egp_service.simulation.scenario_checks import ScenarioError
from rails import rails_car

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

CAR = rails_car("Car", 1225.9, 2.578)
OWN = """
name = "own"
plant = "folder_car:Car"
zones = [{start = 0.0, friction = 0.8}]
[track]
kind = "rounded-rectangle"
"""


@pytest.fixture(autouse=True)
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Stand in `work`, beside which `cars` has a scenario."""
    for name in ("work", "cars"):
        (tmp_path / name).mkdir()
    (tmp_path / "cars/own.toml").write_text(OWN)
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setattr(sys, "path", sys.path.copy())
    yield
    sys.modules.pop("folder_car", None)


def loaded_file(folder: str | None) -> str | None:
    load_simulator("folder_car:Car", folder)
    return sys.modules["folder_car"].__file__


def test_a_module_beside_the_scenario_is_driven(tmp_path: Path) -> None:
    (tmp_path / "cars/folder_car.py").write_text(CAR)
    command = ["drive", "-s", "../cars/own.toml", "--in-process", "--no-pictures", "-o", "runs"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code in {0, NOT_COMPLETED}, result.output
    assert sys.modules["folder_car"].__file__ == str(tmp_path / "work/../cars/folder_car.py")
    # The stored scenario of the run finds it, too.
    (stored,) = (tmp_path / "work/runs").glob("*/scenario.toml")
    assert load_scenario(str(stored)).plant_folder == str(tmp_path / "work/../cars")


def test_a_module_beside_the_scenario_comes_before_one_of_the_working_folder(
    tmp_path: Path,
) -> None:
    for name in ("work", "cars"):
        (tmp_path / name / "folder_car.py").write_text(CAR)
    scenario = load_scenario(str(tmp_path / "cars/own.toml"))
    assert loaded_file(scenario.plant_folder) == str(tmp_path / "cars/folder_car.py")


def test_a_module_of_the_working_folder_is_found_from_any_scenario(tmp_path: Path) -> None:
    (tmp_path / "work/folder_car.py").write_text(CAR)
    scenario = load_scenario(str(tmp_path / "cars/own.toml"))
    assert loaded_file(scenario.plant_folder) == str(tmp_path / "work/folder_car.py")


def test_a_scenario_may_state_the_folder_of_its_plant(tmp_path: Path) -> None:
    (tmp_path / "cars/parts").mkdir()
    (tmp_path / "cars/parts/folder_car.py").write_text(CAR)
    text = 'plant_folder = "parts"\n' + OWN
    scenario = parse_scenario(text, tmp_path / "cars", "own.toml")
    assert loaded_file(scenario.plant_folder) == str(tmp_path / "cars/parts/folder_car.py")
    text = text.replace('plant = "folder_car:Car"\n', "")
    with pytest.raises(ScenarioError, match=r"own.toml: plant_folder has no effect without `plant"):
        parse_scenario(text, tmp_path, "own.toml")


def test_a_module_that_is_in_neither_folder_is_an_error_that_names_both(tmp_path: Path) -> None:
    scenario = load_scenario(str(tmp_path / "cars/own.toml"))
    places = re.escape(f"looked in {tmp_path}/cars, {tmp_path}/work and the installed packages")
    with pytest.raises(PlantError, match=f"No module named 'folder_car'; {places}"):
        loaded_file(scenario.plant_folder)


def test_the_options_simulator_is_not_looked_for_beside_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "cars/folder_car.py").write_text(CAR)
    command = ["drive", "-s", "../cars/own.toml", "--in-process", "--plant", "folder_car:Car"]
    failed = CliRunner().invoke(app, command).exception
    assert f"looked in {tmp_path}/work and the installed packages" in str(failed)


def test_a_module_of_this_name_that_was_imported_before_is_an_error(tmp_path: Path) -> None:
    for name in ("work", "cars"):
        (tmp_path / name / "folder_car.py").write_text(CAR)
    loaded_file(None)
    told = (
        f"{tmp_path}/cars/folder_car.py is not used, because {tmp_path}/work/folder_car.py has the"
    )
    with pytest.raises(PlantError, match=re.escape(told)):
        load_simulator("folder_car:Car", str(tmp_path / "cars"))
