"""Drives that begin badly: far below the reference speed, or with arguments out of range."""

from __future__ import annotations

import gc
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import pytest
from typer.testing import CliRunner

from egp_service import (
    Controller,
    EgpError,
    InvalidArgumentError,
    Plant,
    StatusPublisher,
    VehicleParameters,
    shipped,
)
from egp_service._core import Path as RoadPath
from egp_service.cli import app
from egp_service.control.step import Step
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.course import build_path, start_state
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.runs import new_folder
from egp_service.simulation.scenario import (
    Scenario,
    Track,
    Zone,
    built_in_names,
    load_scenario,
    told_zones,
)
from egp_service.simulation.scenario_checks import ScenarioError
from library_example import write_example

if TYPE_CHECKING:
    from egp_service.simulation.trace import Period

BASE = told_zones(load_scenario("rounded-rectangle"))


@pytest.mark.parametrize("friction", [0.5, 0.8, 1.1])
@pytest.mark.parametrize("v_start", [0.0, 3.0])
def test_a_slow_start_keeps_the_path(friction: float, v_start: float) -> None:
    speed = replace(BASE.speed, v_start=v_start, v_max=20.0)
    scenario = replace(BASE, laps=0.1, zones=(Zone(0.0, friction),), speed=speed)
    with in_process_controller(scenario) as controller:
        run = drive(scenario, controller, lambda _: None)
    assert run.summary.ending.completed
    # From a standstill on 0.5 0.18 m, otherwise at most 0.02 m. Before the drive was bounded for
    # vehicles below their reference, and the reference waited for them, 1.2 to 5.5 m.
    assert run.summary.lateral_error.max < (0.25 if (friction, v_start) == (0.5, 0.0) else 0.1)
    # The force does not alternate between its slew limits.
    steps = np.diff(run.trace.u[:, 0])
    largest = 0.9 * np.abs(steps).max()
    turns = (np.sign(steps[1:]) != np.sign(steps[:-1])) & (np.abs(steps[1:]) > largest)
    assert turns.sum() <= 5


def circle(radius: float, v_max: float, friction: float = 0.8) -> Scenario:
    speed = replace(BASE.speed, v_max=v_max)
    track = Track("circle", parameters={"radius": radius})
    return replace(BASE, track=track, zones=(Zone(0.0, friction),), speed=speed, laps=0.1)


@pytest.mark.parametrize(
    "scenario",
    [
        *map(load_scenario, built_in_names()),
        *(replace(load_scenario("random"), seed=seed) for seed in range(20)),
    ],
)
def test_a_start_on_a_straight_has_neither_yaw_rate_nor_steering(scenario: Scenario) -> None:
    path = build_path(scenario)
    x, y, yaw, *_ = (float(column[0]) for column in path.sample(np.zeros(1)))
    assert start_state(scenario, path, 12.3).tolist() == [x, y, 12.3, yaw, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("radius", "v"), [(15.0, 6.0), (50.0, 10.0), (50.0, 14.0)])
def test_a_car_that_starts_in_a_bend_is_in_its_steady_state(
    radius: float, v: float, side: float
) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    points = radius * np.column_stack([np.sin(angle), side * (1.0 - np.cos(angle))])
    path = RoadPath.from_points(points, closed=True)
    scenario = circle(radius, v)
    start = start_state(scenario, path, v)
    plant = Plant()
    p_x, p_y, v_x, psi, v_y, omega, delta = start
    plant.reset(p_x, p_y, psi, v_x, yaw_rate=omega, v_y=v_y, delta=delta)
    beside = []
    for _ in range(50):  # with the steering angle of the start, at the same speed
        plant.step([5.0 * plant.mass * (v - plant.vehicle_state[2]), 0.0], 0.01, 0.8)
        beside.append(path.project(plant.vehicle_state[:2]).lateral)
    assert np.sign([v_y, omega, delta]).tolist() == [side] * 3
    # Measured 0.002 to 0.012 m; a car that starts straight on 0.25 to 0.49 m.
    assert np.abs(beside).max() < 0.02
    # Measured 1 to 4 % less yaw rate, and up to 0.002 rad between both courses.
    settled = plant.vehicle_state
    assert settled[5] == pytest.approx(omega, rel=0.06)
    assert settled[4] == pytest.approx(v_y, abs=0.004 * v)


def test_a_run_that_starts_in_a_bend_has_no_larger_error_there() -> None:
    scenario = replace(circle(15.0, 10.0), laps=0.4)
    with in_process_controller(scenario) as controller:
        run = drive(scenario, controller, lambda _: None)
    beside = np.abs(run.trace.lateral_error)
    first = run.trace.time < 1.0
    # Without yaw rate, steering and lateral speed at the start 0.475 m in the first second.
    assert beside[first].max() < 0.005 + beside[~first].max() < 0.045  # 0.038 m in both parts


@pytest.mark.parametrize(
    ("radius", "v_start"), [(0.5, 100.0), (3.0, 100.0), (1.0, 0.0), (1.0, 1e-200)]
)
def test_a_start_too_fast_or_too_tight_for_the_bend_is_within_the_cars_limits(
    radius: float, v_start: float
) -> None:
    scenario = circle(radius, 10.0)
    car = Plant().parameters
    x = start_state(scenario, build_path(scenario), v_start)
    _, _, v_x, _, v_y, omega, delta = x
    assert v_x == v_start
    assert abs(delta) <= car.steering_angle
    assert omega * v_x <= 1.01 * car.lateral_grip * 0.8 * 9.81
    assert abs(v_y) <= v_x


def test_a_library_of_another_vehicle_is_driven_with_its_file(tmp_path: Path) -> None:
    car = VehicleParameters.commonroad(1).fields() | {"mass": 1284.0}
    library, file = tmp_path / "own.safetensors", tmp_path / "car.toml"
    write_example(library, vehicle=VehicleParameters(**car))
    file.write_text("".join(f"{name} = {value}\n" for name, value in car.items()))
    scenario = replace(BASE, library=str(library), laps=0.02)
    with pytest.raises(EgpError, match=r"mass is 1225\.887 kg, .* 1284 kg; .*`vehicle_file`"):
        in_process_controller(scenario)
    stated = replace(scenario, vehicle_file=str(file))
    with in_process_controller(stated) as controller:
        assert drive(stated, controller, lambda _: None).summary.ending.completed


@pytest.mark.parametrize(("steering", "speed"), [(0.2, 1.0), (0.0, -1.0)])
def test_a_standing_vehicle_learns_nothing(steering: float, speed: float) -> None:
    """The models let it turn with its wheels, and drive backwards when it brakes."""
    x = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, steering])
    with in_process_controller(BASE) as controller:
        s = speed * np.linspace(0.0, 0.1, controller.horizon + 1)
        reference = np.column_stack([s, 0.0 * s, 0.0 * s + speed, 0.0 * s])
        steps = [controller.step(x, reference) for _ in range(controller.history + 5)]
    assert all(step.status == "solved" for step in steps)
    assert {tuple(step.weights) for step in steps} == {tuple(steps[0].weights)}
    assert all(step.friction is not None and step.friction.information == 0.0 for step in steps)


def test_a_drive_keeps_no_step() -> None:
    """A step has 15 kB of messages and plan."""
    gc.collect()
    before = steps_in_memory()
    alive: list[int] = []

    def observe(period: Period) -> None:
        if period.truth.time > 0.2 and not alive:
            alive.append(steps_in_memory() - before)

    with in_process_controller(BASE) as controller:
        run = drive(replace(BASE, laps=0.03), controller, observe)
        assert run.deadline == controller.deadline == pytest.approx(0.8 * run.dt)
    assert alive == [1]


def steps_in_memory() -> int:
    # Objects of other libraries may compute their class, with warnings.
    return sum(type(each) is Step for each in gc.get_objects())


def test_a_scenario_that_was_changed_is_checked() -> None:
    scenario = replace(BASE, laps=float("nan"))
    with (
        in_process_controller(BASE) as controller,
        pytest.raises(ScenarioError, match="rounded-rectangle: laps"),
    ):
        drive(scenario, controller, lambda _: None)


def test_a_run_has_a_new_folder_or_an_error_that_names_the_path(tmp_path: Path) -> None:
    root = tmp_path / "new" / "runs"
    folders = [new_folder(root, "own") for _ in range(3)]
    assert sorted(root.iterdir()) == sorted(set(folders))
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "nothing")
    for name in ("file", "link"):
        with pytest.raises(NotADirectoryError, match=rf"this is no folder; .*/{name}'$"):
            new_folder(tmp_path / name, "own")


def test_a_status_that_cannot_be_published_is_an_error_at_once() -> None:
    x = np.array([0.0, 0.2, 15.0, 0.0, 0.0, 0.0, 0.0])
    with Controller(shipped.DEMO_LIBRARY, gate=Plant().parameters.gate_limits()) as controller:
        s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
        step = controller.step(x, np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s]))
        with StatusPublisher(controller, "tcp/127.0.0.1:9") as status:
            status.add(step, x, 0.0)
            with pytest.raises(InvalidArgumentError, match=r"x has shape \(3,\): expected \(7,\)"):
                status.add(step, x[:3], 0.02)
        with pytest.raises(EgpError, match="the publisher was closed"):
            status.add(step, x, 0.04)


@pytest.mark.parametrize(
    ("mode", "status", "misses"),
    [("normal", "solved", 0), ("normal", "late", 1), ("tail", "late", 1), ("stop", "solved", 1)],
)
def test_a_plan_that_came_after_the_deadline_is_a_miss(
    mode: Literal["normal", "tail", "stop"], status: str, misses: int
) -> None:
    x = np.array([0.0, 0.2, 15.0, 0.0, 0.0, 0.0, 0.0])
    with Controller(shipped.DEMO_LIBRARY, gate=Plant().parameters.gate_limits()) as controller:
        s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
        step = controller.step(x, np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s]))
        with StatusPublisher(controller, "tcp/127.0.0.1:9") as published:
            published.add(replace(step, mode=mode, status=status), x, 0.0)
            assert published._counts()["misses"] == misses  # noqa: SLF001


def test_a_deadline_of_a_minute_is_one_of_ten_seconds() -> None:
    with Controller(shipped.DEMO_LIBRARY, gate=Plant().parameters.gate_limits()) as controller:
        s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
        reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
        for deadline in (9.9, 60.0, 1e30):
            step = controller.step([0, 0.2, 15, 0, 0, 0, 0], reference, deadline=deadline)
            assert (step.mode, step.status) == ("normal", "solved"), step.detail


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[speed]\nv_start = -8.0", "own.toml: speed.v_start must be"),
        ("[speed]\nv_max = 20000.0", "own.toml: speed.v_max must be"),
        ("[gate]\nnope = 1.0", 'unknown gate setting "nope"'),
        ("[gate]\nforce_max = -1.0", "gate limit force_max must be"),
    ],
)
def test_a_scenario_that_cannot_be_driven_is_named_before_its_run_has_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, told: str
) -> None:
    monkeypatch.chdir(tmp_path)
    head = 'name = "own"\ntrack = {kind = "circle"}\nzones = [{start = 0.0, friction = 1.0}]\n'
    Path("own.toml").write_text(head + text)
    result = CliRunner().invoke(app, ["drive", "-s", "own.toml", "--in-process", "--no-pictures"])
    assert isinstance(result.exception, EgpError)
    assert told in str(result.exception)
    notes = getattr(result.exception, "__notes__", [])
    assert notes == (["in [gate] of own.toml"] if "gate" in told else [])
    assert [path.name for path in tmp_path.iterdir()] == ["own.toml"]


def test_pictures_that_cannot_be_drawn_are_an_error_before_the_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "egp_service.simulation.report", None)
    result = CliRunner().invoke(app, ["drive", "--in-process", "-o", str(tmp_path / "runs")])
    assert isinstance(result.exception, ModuleNotFoundError)
    assert not (tmp_path / "runs").exists()
