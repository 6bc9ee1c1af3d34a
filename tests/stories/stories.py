"""What a new user does first, with the installed package alone: one story for each kind of work.

`tests/stories/fresh.py` runs this file with pytest in a fresh environment, outside the source.
"""

from __future__ import annotations

import importlib.util
import inspect
import json
import os
import pydoc
import re
import signal
import socket
import subprocess
import sys
import sysconfig
import time
from importlib.metadata import metadata
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from typer.testing import CliRunner

import egp_service
from egp_service import Controller, Plant, Recorder, shipped
from egp_service.cli import app
from egp_service.control.endpoints import free_endpoint

EGP = Path(sysconfig.get_path("scripts")) / "egp"
MASS = 1225.887  # kg, of the simulated car
LIBRARY = str(shipped.DEMO_LIBRARY)
SIMULATOR = '''
import numpy as np

class Slider:
    """A single track that never slips, in twenty lines."""

    def reset(self, x):
        self.x = np.array(x, dtype=float)

    def step(self, u, dt, friction):
        p_x, p_y, v_x, psi, v_y, omega, delta = self.x
        delta += dt * u[1]
        v_x += dt * u[0] / 1225.887
        omega = v_x * np.tan(delta) / 2.39264
        v_y = 1.50876 * omega
        psi += dt * omega
        p_x += dt * (v_x * np.cos(psi) - v_y * np.sin(psi))
        p_y += dt * (v_x * np.sin(psi) + v_y * np.cos(psi))
        self.x = np.array([p_x, p_y, v_x, psi, v_y, omega, delta])

    @property
    def state(self):
        return self.x
'''


def egp(*arguments: str, code: int = 0) -> str:
    """Run `egp` for at most 60 s in the story's folder; return what it wrote."""
    done = subprocess.run(
        [EGP, *arguments], capture_output=True, text=True, check=False, timeout=60.0, stdin=None
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_log(path: Path, friction: float) -> None:
    """Write a log of 12 s at 50 Hz, weaving at 8 to 14 m/s, in the units of a user's logger."""
    car = Plant()
    car.reset(0.0, 0.0, 0.0, 8.0)
    lines = ["t,speed,lateral,yaw_rate,wheel,accel"]
    for k in range(600):
        _, _, v_x, _, v_y, omega, delta = car.vehicle_state
        u = np.array([600.0 + 1800.0 * np.sin(0.05 * k), 0.12 * np.sin(0.06 * k + 1.5)])
        row = [0.02 * k, 3.6 * v_x, v_y, np.degrees(omega), np.degrees(delta), u[0] / MASS]
        lines.append(",".join(f"{value:.9g}" for value in row))
        car.step(u, 0.02, friction)
    path.write_text("\n".join(lines))


COLUMNS = [f"--mass={MASS}"] + [
    f"--column={column}"
    for column in (
        "time=t:s", "v_x=speed:km/h", "v_y=lateral:m/s", "omega=yaw_rate:deg/s",
        "delta=wheel:deg", "a_x=accel:m/s2",
    )
]  # fmt: skip


def test_1_a_log_is_imported_and_a_wrong_unit_is_named(folder: Path) -> None:
    write_log(folder / "drive.csv", 0.8)
    log = ["collect", "-o", "own.parquet", "--friction", "0.8", "--from-log", "drive.csv"]
    assert "599 transitions" in egp(*log, *COLUMNS)
    wrong = [column.replace("speed:km/h", "speed:m/s") for column in COLUMNS]
    told = egp(*log, *wrong, code=1)
    assert "'speed' and 'accel' contradict each other" in told
    assert "'speed' is read in m/s" in told


def test_2_a_fit_without_its_extra_names_it(folder: Path) -> None:
    if importlib.util.find_spec("torch") is not None:
        pytest.skip("torch is installed: tests/train/test_vehicle_fit.py fits a vehicle")
    write_log(folder / "drive.csv", 0.8)
    egp("collect", "-o", "own.parquet", "--friction=0.8", "--from-log=drive.csv", *COLUMNS)
    told = egp("vehicle", "fit", "own.parquet", code=1)
    assert "pip install 'egp-service[train]'" in told


def write_scenario(path: Path, laps: float) -> None:
    """Write the scenario of a part of a lap."""
    scenario = Path(egp_service.__file__).parent / "simulation/scenarios/rounded-rectangle.toml"
    short = re.sub(r"(?m)^laps = .*$", "", scenario.read_text())
    path.write_text(f"laps = {laps}\n{short}")


def test_3_and_5_an_own_simulator_is_driven_recorded_replayed_and_viewed(folder: Path) -> None:
    (folder / "slider.py").write_text(SIMULATOR)
    write_scenario(folder / "short.toml", 0.05)
    egp("drive", "--plant=slider:Slider", "-s", "short.toml", "--in-process", "-o", "runs")
    (run,) = (folder / "runs").iterdir()
    assert json.loads((run / "summary.json").read_text())["lateral_error"]["max"] < 0.5
    assert {path.suffix for path in run.iterdir()} >= {".png", ".mcap", ".json", ".xml"}
    assert "have the same bytes as recorded" in egp("replay", str(run / "run.mcap"))
    if importlib.util.find_spec("rerun") is None:
        told = egp("view", str(run / "run.mcap"), code=1)
        assert "pip install 'egp-service[view]'" in told
    else:
        assert "Saved run.rrd" in egp("view", str(run / "run.mcap"), "--save", "run.rrd")


def test_4_a_step_says_what_was_found(folder: Path) -> None:
    limits = Plant().parameters.gate_limits()
    with Controller(LIBRARY, gate=limits) as controller:
        s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
        reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
        with Recorder(folder / "own.mcap", controller) as recorder:
            state = np.array([0.0, 0.2, 15.0, 0.0, 0.0, 0.0, 0.0])
            step = controller.step(state, reference)
            recorder.add(step, state, 0.0)
    assert step.u[1] < 0.0  # to the right, because the car is left of the path
    assert step.friction is not None
    assert "normal, solved" in repr(step)
    assert "rad" in str(Plant.step.__doc__)
    assert "All 1 replies have the same bytes" in egp("replay", "own.mcap")


def test_6_a_live_page_shows_a_car_that_drives(folder: Path) -> None:
    write_scenario(folder / "half.toml", 0.5)
    endpoint = free_endpoint()
    deadline = time.monotonic() + 30.0
    nobody = free_endpoint()
    monitor = subprocess.Popen(
        [EGP, "monitor", "--listen", endpoint, "--connect", nobody, "--port", "0"],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    assert monitor.stdout is not None
    try:
        (url,) = re.findall(r"http://[\d.]+:\d+", monitor.stdout.readline())
        with urlopen(url, timeout=10) as page:  # noqa: S310 - this machine
            assert "<title>egp monitor</title>" in page.read().decode()
        car = ["--monitor", endpoint, "--vehicle", "car-7"]
        egp("drive", "-s", "half.toml", "--in-process", "--no-pictures", *car)
        # The page's events; those of a car have its curves.
        with urlopen(f"{url}/events?vehicle=default/car-7", timeout=10) as stream:  # noqa: S310
            shown: dict[str, Any] = {}
            while "detail" not in shown:
                assert time.monotonic() < deadline
                name, _, data = stream.readline().decode().partition(": ")
                shown = json.loads(data) if name == "data" else {}
        (row,) = shown["fleet"]["vehicles"]
        assert (row["id"], row["state"], row["replica"]) == ("default/car-7", "ended", "in-process")
        assert shown["detail"]["members"] == ["mu 0.5", "mu 1.1"]
        assert len(shown["detail"]["samples"]) > 1
    finally:
        monitor.terminate()
        monitor.wait(timeout=20)
        monitor.stdout.close()


def test_7_the_commands_tell_what_they_do() -> None:
    assert re.match(r"egp-service \d+\.\d+", egp("--version"))
    assert "cost.lateral" in egp("settings", "lateral")
    assert "solved" in egp("doctor")


def test_8_parameters_of_autoware_become_settings(folder: Path) -> None:
    lines = ["mpc_prediction_horizon: 50", "mpc_prediction_dt: 0.02", "mpc_weight_lat_error: 1.0"]
    file = folder / "lateral.param.yaml"
    file.write_text("\n    ".join(["/**:\n  ros__parameters:", *lines]) + "\n")
    assert "ros2 run rmw_zenoh_cpp rmw_zenohd" in egp("ros2", "--help")
    (folder / "settings.toml").write_text(egp("ros2", "--autoware-parameters", str(file)))
    assert "horizon = 50" in (folder / "settings.toml").read_text()
    told = egp("ros2", "--router=tcp/127.0.0.1:9", "--settings=settings.toml", code=1)
    assert "rmw_zenohd" in told


def test_9_every_command_that_is_named_explains_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    overview, readme = egp("--help"), str(metadata("egp-service").json["description"])
    commands = re.findall(r"(?m)^│ ([a-z0-9]+) ", overview)
    named = set(re.findall(r"\begp ([a-z0-9]+)", overview + readme))
    assert {"collect", "train", "drive", "replay", "serve"} <= named <= set(commands)
    for name in (*commands, "vehicle fit"):
        text = CliRunner().invoke(app, [*name.split(), "--help"]).output
        assert max(map(len, text.splitlines())) <= 80, name
        assert re.search(rf"(?m)^ +(For example: )?egp {name}\b", text), f"no example: {name}"


def test_9_help_explains_every_public_name() -> None:
    assert len(egp_service.__all__) > 10
    for name in egp_service.__all__:
        thing = getattr(egp_service, name)
        assert len(inspect.getdoc(thing) or "") > 20, name
        assert name in pydoc.plain(pydoc.render_doc(thing))
        for member, value in vars(thing).items() if inspect.isclass(thing) else ():
            told = inspect.isroutine(value) or isinstance(value, property)
            if not member.startswith("_") and (told or inspect.isgetsetdescriptor(value)):
                assert inspect.getdoc(value), f"{name}.{member}"


def test_9_the_example_of_the_readme_runs(capfd: pytest.CaptureFixture[str]) -> None:
    readme = str(metadata("egp-service").json["description"])
    (example,) = re.findall(r"(?s)```python\n(.*?)```", readme)
    exec(example, {})  # noqa: S102
    assert "normal" in capfd.readouterr().out


def test_10_the_service_the_load_and_the_simulation_come_with_the_wheel(folder: Path) -> None:
    endpoint = free_endpoint()
    service = subprocess.Popen([EGP, "serve", LIBRARY, "--listen", endpoint])
    try:
        deadline = time.monotonic() + 20.0
        port = int(endpoint.rpartition(":")[2])
        while socket.socket().connect_ex(("127.0.0.1", port)):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        short = ["--vehicles=1", "--seconds=0.5", "--warm-up=0.1", "--json=load.json"]
        assert "latency from due time" in egp("load", "--connect", endpoint, *short)
        assert json.loads((folder / "load.json").read_text())["requests"] == 25
    finally:
        service.send_signal(signal.SIGTERM)
        assert service.wait(timeout=20) == 0
    assert "no oracle was violated" in egp("simulate", "--seeds=0..1", "--seconds=0.5")


def test_10_a_service_is_closed_to_strangers(folder: Path) -> None:
    egp("keys", "secrets", "--vehicle", "car-1", "--host", "127.0.0.1")
    (folder / "service.toml").write_text(
        f'library = "{LIBRARY}"\nvehicle_keys = "secrets/vehicles.keys"\n'
        'zenoh_file = "secrets/service.json5"\n'
    )
    assert "surfaces: mu 0.5, mu 1.1" in egp("serve", "--config", "service.toml", "--check")


def write_circuit(path: Path) -> None:
    """Write the centre line of a small oval for cars of 1:10, as TUM's database has them."""
    angle = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    r = 2.0 * (1.0 + 0.1 * np.cos(3.0 * angle))
    rows = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full((60, 2), 0.4)])
    np.savetxt(path, rows, delimiter=",", header="x_m,y_m,w_tr_right_m,w_tr_left_m")


def test_11_a_run_has_its_pictures(folder: Path) -> None:
    write_scenario(folder / "short.toml", 0.05)
    shown = egp("drive", "-s", "short.toml", "--in-process", "-o", "runs")
    assert max(map(len, shown.splitlines())) <= 80
    pictures = {path.stem: path.stat().st_size for path in (folder / "runs").glob("*/*.png")}
    assert set(pictures) == {"track", "weights", "errors", "step-times", "commands"}
    assert min(pictures.values()) > 10_000


def test_11_an_evaluation_without_its_extra_names_it(folder: Path) -> None:
    if importlib.util.find_spec("torch") is not None:
        pytest.skip("torch is installed: tests/evaluation/test_own_track.py reads the report")
    write_circuit(folder / "oval.csv")
    circuit = ["-e", "unseen-track", "--track", "oval.csv", "--scale", "10"]
    told = egp("evaluate", *circuit, code=1)
    assert "pip install 'egp-service[train]'" in told


def test_11_the_package_is_the_installed_one() -> None:
    package = Path(egp_service.__file__)
    assert package.is_relative_to(sys.prefix), package
    assert all(file.exists() for file in vars(shipped).values() if isinstance(file, Path))
