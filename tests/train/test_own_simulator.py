"""`egp collect --plant`: data of a user's simulator."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest
from typer.testing import CliRunner

from egp_service import EgpError, VehicleParameters
from egp_service._core import GRAVITY
from egp_service.cli import app
from egp_service.control.toml_text import dumps
from egp_service.data.dataset import Dataset
from rails import rails_car

if TYPE_CHECKING:
    from pathlib import Path

# A car without slip, whose tyres transmit what the friction allows along the road.
SLIDER = (
    rails_car("Rails", 1800.0, 2.9)
    + f"""
class Car(Rails):
    def step(self, u, dt, friction):
        most = 1800.0 * friction * {GRAVITY}
        super().step([min(most, max(-most, u[0])), u[1]], dt, friction)

class Failing(Car):
    def step(self, u, dt, friction): raise ZeroDivisionError("solver diverged")

class Lost(Car):
    def step(self, u, dt, friction): self.state = [math.nan] * 7
"""
)
SUV = VehicleParameters(
    **VehicleParameters.commonroad(1).fields()
    | {"mass": 1800.0, "yaw_inertia": 3300.0, "l_f": 1.35, "l_r": 1.55, "steering_angle": 0.6}
)
COLLECT = ["collect", "--friction", "snow", "--vehicle", "suv.toml", "-o", "data.parquet"]
SHORT = "--runs 2 --samples 60 --steady 20 --track rounded-rectangle --seed 3"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    sys.modules.pop("slider_car", None)
    (tmp_path / "slider_car.py").write_text(SLIDER)
    (tmp_path / "suv.toml").write_text(dumps(SUV.fields()))
    return tmp_path


def collected(*arguments: str) -> Dataset:
    result = CliRunner().invoke(app, [*COLLECT, *SHORT.split(), *arguments])
    assert result.exit_code == 0, result.output
    return Dataset.read("data.parquet")


def failure(*arguments: str) -> str:
    error = CliRunner().invoke(app, [*COLLECT, *SHORT.split(), *arguments]).exception
    assert isinstance(error, EgpError), error
    return str(error)


def test_data_are_those_of_the_simulator_within_the_limits_of_its_car() -> None:
    data = collected("--plant", "slider_car:Car", "--jobs", "1")
    origin = data.provenance
    assert (origin.vehicle, origin.surface, origin.friction) == ("suv", "snow", 0.3)
    methods = ("random sampling", "steady inputs", "track")
    assert origin.method == " + ".join(f"{it} in slider_car:Car" for it in methods)
    v_x, v_y, omega, delta, force, rate = data.z.T
    assert len(data) > 10_000
    assert not v_y.any()
    # The simulator's equations, with the friction of the surface.
    a = np.clip(force / 1800.0, -0.3 * GRAVITY, 0.3 * GRAVITY)
    np.testing.assert_allclose(data.y[:, 0], 0.02 * a, atol=1e-12)
    turning = (v_x + 0.02 * a) * np.tan(delta + 0.02 * rate) / 2.9
    np.testing.assert_allclose(data.y[:, 2], turning - omega, atol=1e-12)
    assert np.ptp(a) > 0.59 * GRAVITY
    # The limits of the car; the built-in car steers up to 0.91 rad and has 1226 kg.
    assert 0.4 < np.abs(delta).max() <= 0.6
    assert np.abs(rate).max() <= SUV.steering_rate
    assert 0.55 * GRAVITY < np.abs(force).max() / 1800.0 <= 0.6 * GRAVITY + 1e-9
    # Each process makes a simulator of its own.
    assert collected("--plant", "slider_car:Car", "--jobs", "2").digest() == data.digest()


def test_random_states_can_be_left_out() -> None:
    data = collected("--plant", "slider_car:Car", "--jobs", "1", "--samples", "0")
    method = "steady inputs in slider_car:Car + track in slider_car:Car"
    assert data.provenance.method == method


def test_what_does_not_fit_a_simulator_is_named(folder: Path) -> None:
    plant = ("--plant", "slider_car:Car")
    told = failure(*plant, "--vehicle", "1")
    assert told.startswith("--plant slider_car:Car needs the mass, axles and limits of its car")
    told = failure(*plant, "--disturbance", "load=100")
    assert told == "--disturbance has no effect on a simulator of your own"
    assert "the TOML file of a car goes with --plant" in failure()
    (folder / "log.csv").write_text("t\n0\n")
    told = failure(*plant, "--from-log", "log.csv")
    every = "--track, --runs, --samples, --steady, --seed, --plant"
    assert told.startswith(f"{every} can be given for simulated")
    assert "no attribute 'Van'" in failure("--plant", "slider_car:Van")
    for more in ((), ("--samples", "0"), ("--samples", "0", "--steady", "0", "--jobs", "2")):
        told = failure("--plant", "slider_car:Failing", *more)
        assert "slider_car:Failing.step: ZeroDivisionError: solver diverged (" in told
    assert "all 60 samples spun or stopped" in failure("--plant", "slider_car:Lost")
    assert not (folder / "data.parquet").exists()
