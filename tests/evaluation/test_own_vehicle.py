"""An evaluation of one's own vehicle: its simulator and its library."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import numpy as np
import pytest
from typer.testing import CliRunner

from egp_service._core import Library, VehicleParameters, write_library
from egp_service.cli import app
from egp_service.evaluation import baselines, experiments
from egp_service.evaluation.campaign import VEHICLE_FILE, fingerprint
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE
from egp_service.evaluation.experiments import EXPERIMENTS, OBSTACLE_AVOIDANCE, on_plant
from egp_service.evaluation.unknown_roads import ASSUMED, BELIEF, FIRST
from egp_service.shipped import EVALUATION_LIBRARY
from egp_service.simulation.scenario import vehicle_parameters
from egp_service.vehicle import read_vehicle
from fewer_contenders import with_contenders
from rails import rails_car

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from egp_service.evaluation.experiment import ClosedLoopExperiment

BODY = {"mass": 1800.0, "yaw_inertia": 3300.0, "l_f": 1.35, "l_r": 1.55, "width": 1.95}
SUV = VehicleParameters(**(VehicleParameters.commonroad(1).fields() | BODY))
# A simulator that fails at once, beside the vehicle that it is derived from.
SIMULATORS = (
    rails_car("Suv", 1800.0, 2.9)
    + """
class Failing(Suv):
    def step(self, u, dt, friction):
        self.state = [math.nan] * 7
"""
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    sys.modules.pop("suv_car", None)
    (tmp_path / "suv_car.py").write_text(SIMULATORS)
    return tmp_path


def write_suv(path: Path) -> None:
    """Write a library of the four surfaces' members, which are vehicles without GPs."""
    like = Library.load(EVALUATION_LIBRARY).members[0]
    tyred = baselines.single_track(SUV)
    members = [
        baselines._vehicle_alone(  # noqa: SLF001
            f"mu {mu}", mu, like, like.envelope * SUV.mass / 1225.0, {"single_track": tyred}
        )
        for mu in (0.5, 0.6, 0.9, 1.1)
    ]
    write_library(
        path,
        dt=0.02,
        kernel="rbf",
        vehicle="suv",
        parameters=SUV,
        members=members,
        provenance={"source": "tests"},
    )


def named(name: str) -> ClosedLoopExperiment:
    return next(e for e in EXPERIMENTS if e.name == name)


def test_gate_speeds_and_baselines_are_those_of_the_librarys_vehicle(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    contenders = (ENSEMBLE, "pooled GP", "nominal single-track", "kinematic", ORACLE)
    fewer = with_contenders(named("lane-change"), *contenders)
    monkeypatch.setattr(experiments, "EXPERIMENTS", (replace(fewer, quick_seeds=1),))
    write_suv(folder / "suv.safetensors")
    command = ["evaluate", "-e", "lane-change", "--plant", "suv_car:Suv", "-o", "out"]
    result = CliRunner().invoke(app, [*command, "--library", "suv.safetensors"])
    assert result.exit_code == 0, result.output
    output = " ".join(result.output.split())
    assert "Left out, as suv.safetensors lacks their members: pooled GP." in output
    assert "state its library" not in output
    assert "did not complete" not in output
    assert read_vehicle(folder / "out" / VEHICLE_FILE) == SUV
    for kind in ("single-track", "kinematic"):
        library = Library.load(folder / f"out/libraries/{kind}-own-0-3.safetensors")
        assert (library.vehicle, library.parameters) == ("suv", SUV)
    report = " ".join((folder / "out/report.html").read_text(encoding="utf-8").split())
    assert "of the vehicle <i>suv</i> of 1800 kg, with the members <i>mu 0.5</i>," in report
    assert "simulator <code>suv_car:Suv</code>" in report


def test_what_a_failing_simulator_does_is_told(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    del folder
    fewer = with_contenders(named(FIRST), ORACLE, f"{BELIEF}5%", f"{ASSUMED}0.4")
    monkeypatch.setattr(experiments, "EXPERIMENTS", (fewer,))
    command = ["evaluate", "-e", FIRST, "--plant", "suv_car:Failing", "-o", "out"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 3, result.output
    output = " ".join(result.output.split())
    # Nothing says which vehicle the simulator has.
    assert (
        "those of commonroad-1, 1225.89 kg. If suv_car:Failing is another vehicle, state" in output
    )
    assert "unknown-roads first lap, found, risk 5% 0/1 0/1 assumed 0.4 0/1" in output
    told = "lost control (first: suv_car:Failing.state after step is not finite: [nan, nan,"
    assert f"3 of 3 runs did not complete. Most frequent reasons: - 3 of them: {told}" in output


def test_steps_of_the_simulator_are_timed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measure = Mock(return_value=[])
    monkeypatch.setattr("egp_service.evaluation.scaling.measure", measure)
    write_suv(folder / "suv.safetensors")
    command = ["evaluate", "-e", "step-times", "--plant", "suv_car:Suv", "-o", "out"]
    result = CliRunner().invoke(app, [*command, "--library", "suv.safetensors"])
    assert result.exit_code == 0, result.output
    _, scenario = measure.call_args.args
    assert scenario.plant == "suv_car:Suv"
    assert vehicle_parameters(scenario) == SUV


def edge_margin(control: Mapping[str, Any] | None) -> float:
    assert control is not None
    return float(control["soft"]["edge_margin"])


def test_roads_and_margins_have_the_vehicles_width(tmp_path: Path) -> None:
    narrow, cones = (
        on_plant(e, "a:B", SUV, tmp_path / VEHICLE_FILE)
        for e in (named("narrow-track"), OBSTACLE_AVOIDANCE)
    )
    road = narrow.conditions[0][1].track.parameters["track_width"]
    assert road == pytest.approx(BODY["width"] + 0.8)
    controls = [c.control for c in narrow.contenders] + [s.control for _, s in cones.conditions]
    assert {edge_margin(control) for control in controls} == {0.5 * BODY["width"]}


def test_runs_belong_to_the_content_of_the_vehicles_file(tmp_path: Path) -> None:
    prints = set()
    for place, mass in (("a", 1800.0), ("a", 1810.0), ("b", 1800.0)):
        file = tmp_path / place / VEHICLE_FILE
        file.parent.mkdir(exist_ok=True)
        fields = SUV.fields() | {"mass": mass}
        file.write_text("".join(f"{name} = {value}\n" for name, value in fields.items()))
        trial = next(on_plant(named("lane-change"), "a:B", SUV, file).trials([0]))
        assert vehicle_parameters(trial.scenario).mass == mass
        prints.add(fingerprint(trial, "any"))
    assert len(prints) == 2


def test_nominal_vehicles_of_a_library_are_those_that_it_states(tmp_path: Path) -> None:
    write_suv(tmp_path / "suv.safetensors")
    path = tmp_path / "nominal.safetensors"
    baselines.write(path, "single-track", tmp_path / "suv.safetensors", [0, 3], None)
    (member,) = Library.load(path).members
    assert member.single_track is not None
    mass, front, rear, radius, height = member.single_track[:5]
    assert (mass, front, rear) == (1800.0, 1.35, 1.55)
    assert radius == pytest.approx(3300.0 / 1800.0)
    assert 0.4 < height < 0.7
    baselines.write(path, "kinematic", tmp_path / "suv.safetensors", [0, 3], None)
    (member,) = Library.load(path).members
    np.testing.assert_array_equal(member.kinematic, [1800.0, 1.35, 1.55])
