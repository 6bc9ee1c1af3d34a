"""Columns of a log that contradict each other, and sound logs that do not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from plant_log import COLUMNS, MASS, plant_log
from surfaces import provenance

from egp_service import EgpError
from egp_service.data import plausibility
from egp_service.data.log_import import Column, import_log

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from plant_log import Log


def check(log: Log) -> None:
    plausibility.check(log, COLUMNS, MASS)


@pytest.mark.parametrize("file", ["absent.csv", "absent.mcap"])
@pytest.mark.parametrize(
    ("changes", "mass", "complaint"),
    [
        ({}, None, "mass in kg .*: state --mass"),
        ({"v_x": Column("speed", "rad")}, MASS, "v_x from 'speed': rad is not a unit of v_x"),
        ({"slip": Column("slip", "rad")}, MASS, "unknown quantity 'slip': expected time, v_x"),
    ],
)
def test_wrong_columns_are_named_before_the_log_is_read(
    tmp_path: Path, file: str, changes: dict[str, Column], mass: float | None, complaint: str
) -> None:
    columns = COLUMNS | changes
    if file.endswith(".mcap"):
        columns.pop("time")
    with pytest.raises(EgpError, match=complaint):
        import_log(tmp_path / file, columns, provenance(), mass=mass)


def test_a_straight_road_is_no_stuck_sensor() -> None:
    straight = plant_log(straight=400)
    assert not straight["delta"][:400].any()
    check(straight)
    # Rounded to 0.1 degrees, with noise of the other sensors.
    rng = np.random.default_rng(0)
    for name, noise in (("v_x", 0.014), ("v_y", 0.01), ("omega", 0.001)):
        straight[name] += noise * rng.standard_normal(1500)
    straight["delta"] = np.deg2rad(np.round(np.rad2deg(straight["delta"]), 1))
    check(straight)


def test_a_bend_at_a_constant_steering_angle_is_no_stuck_sensor() -> None:
    """The constant steering-wheel angle test of ISO 4138: the speed rises in a circle."""
    time = np.arange(0.0, 40.0, 0.02)
    v_x = 5.0 + 0.3 * time
    omega = 0.1 * v_x / (2.4 + 0.003 * v_x**2)
    delta, v_y = np.full_like(time, 0.1), 1.5 * omega - 0.02 * v_x * omega
    log = {"time": time, "v_x": v_x, "v_y": v_y, "omega": omega, "delta": delta}
    check(log | {"a_x": 0.3 - v_y * omega})


@pytest.mark.parametrize("quantity", ["v_x", "v_y", "omega", "delta", "a_x"])
def test_a_stuck_sensor_is_found_by_a_column_that_says_the_same(quantity: str) -> None:
    log = plant_log()
    log[quantity][500:900] = log[quantity][500]
    with pytest.raises(EgpError, match=f"'{quantity}' stays at .* 8 s"):
        check(log)


@pytest.mark.parametrize("quantity", ["v_x", "v_y", "omega", "delta", "a_x"])
def test_a_column_that_never_changes_was_probably_not_measured(quantity: str) -> None:
    log = plant_log()
    log[quantity][:] = log[quantity][500]
    message = f"'{quantity}' stays at .* from row 0 to 1499, 30 s, .* probably not measured; name"
    with pytest.raises(EgpError, match=message):
        check(log)
    log[quantity][0] += 1e-3
    with pytest.raises(EgpError, match=r"from row 1 to 1499, .* the sensor was probably stuck"):
        check(log)


def gentle_log() -> Log:
    """Return a log as of the AV-21: wide curves, and an acceleration that is late by 1 s."""
    t = np.arange(0.0, 120.0, 0.04)
    v_x = 14.0 + 4.0 * np.sin(0.2 * t) + 2.0 * np.sin(0.53 * t)
    omega = 0.045 * np.sin(0.11 * t)
    late = t - 1.0
    return {
        "time": t,
        "v_x": v_x,
        "v_y": 0.1 * omega,
        "omega": omega,
        "delta": 3.0 * omega / v_x,
        "a_x": 0.8 * np.cos(0.2 * late) + 1.06 * np.cos(0.53 * late),
    }


@pytest.mark.parametrize("make", [plant_log, gentle_log])
@pytest.mark.parametrize(
    ("quantity", "factor", "complaint"),
    [
        ("v_x", -1.0, "drives backwards: 'v_x' has probably the wrong sign"),
        ("a_x", -1.0, "slows down when it accelerates"),
        ("a_x", 1.0 / 9.81, "times as fast as the acceleration says"),
        ("a_x", 1e-3, "read in m/s2 hardly does"),
        ("a_x", 0.0, "hardly does|'a_x' stays at 0"),
        ("omega", -1.0, "opposite signs"),
        ("delta", 1.0 / 57.3, "a wrong unit"),
        ("delta", 1.0 / 16.0, "a wrong unit"),
    ],
)
def test_wrong_signs_and_units_are_errors(
    make: Callable[[], Log], quantity: str, factor: float, complaint: str
) -> None:
    log = make()
    check(log)
    log[quantity] = factor * log[quantity]
    with pytest.raises(EgpError, match=complaint):
        check(log)


def test_the_sign_of_a_force_is_told_without_the_mass() -> None:
    log = plant_log()
    log["F_x"] = MASS * log.pop("a_x")
    columns = COLUMNS | {"F_x": COLUMNS["a_x"]}
    plausibility.check(log, columns)
    log["F_x"] = -log["F_x"]
    with pytest.raises(EgpError, match="slows down when it accelerates"):
        plausibility.check(log, columns)


def test_a_vehicle_that_mostly_stands_does_not_move_sideways() -> None:
    log = plant_log()
    rest = 3000
    standing = {name: np.full(rest, 0.0) for name in log} | {"v_y": np.full(rest, 0.01)}
    standing["time"] = 0.02 * np.arange(rest)
    log["v_x"] -= 8.0 * np.exp(-log["time"])  # starts from standstill
    log["time"] += 0.02 * rest
    check({name: np.concatenate([standing[name], log[name]]) for name in log})


def pieces(*speeds: float, seconds: float = 10.0, pause: float = 60.0) -> Log:
    """Return drives from given speeds, m/s, with pauses in which nothing is recorded."""
    t = np.arange(0.0, seconds, 0.02)
    omega = 0.1 * np.sin(0.8 * t)
    parts = []
    for number, speed in enumerate(speeds):
        v_x = speed + 2.0 * np.sin(0.7 * t)
        columns = (number * (seconds + pause) + t, v_x, 0.1 * omega, omega, 2.7 * omega / v_x)
        parts.append(np.array([*columns, 1.4 * np.cos(0.7 * t) - 0.1 * omega**2]))
    return dict(zip(COLUMNS, np.hstack(parts), strict=True))


def test_speeds_on_both_sides_of_a_pause_are_not_compared() -> None:
    log = pieces(*(8.0, 25.0, 12.0, 30.0) * 2)
    log["F_x"] = MASS * log.pop("a_x")
    columns = COLUMNS | {"F_x": COLUMNS["a_x"]}
    plausibility.check(log, columns, MASS)
    log["F_x"] = -log["F_x"]
    with pytest.raises(EgpError, match="slows down when it accelerates"):
        plausibility.check(log, columns, MASS)


def test_demands_beyond_the_grip_are_no_wrong_unit() -> None:
    t = np.arange(0.0, 120.0, 0.02)
    demand = np.sin(0.7 * t) * np.where(np.sin(0.1 * t) > 0.5, 8.0, 1.0)
    log = pieces(20.0, seconds=120.0)
    change = np.clip(demand, -1.2, 1.2)
    log["v_x"] = 20.0 + np.concatenate([[0.0], 0.02 * np.cumsum(change[:-1])])
    log["delta"] = 2.7 * log["omega"] / log["v_x"]
    log["a_x"] = demand - 0.1 * log["omega"] ** 2
    check(log)
    log["a_x"] = log["a_x"] / 9.81
    with pytest.raises(EgpError, match="contradict each other"):
        check(log)


def test_the_same_value_on_both_sides_of_a_pause_is_no_stuck_sensor() -> None:
    log = pieces(10.0, 10.0, seconds=4.0)
    log["v_x"] = np.full_like(log["time"], 10.0)  # of a sensor with steps of 1 m/s
    log["a_x"] = 0.4 * np.sign(log["time"] - 30.0)
    check(log)
    # Without the pause the acceleration says that the speed has changed.
    log["time"] = np.linspace(0.0, 7.98, len(log["time"]))
    with pytest.raises(EgpError, match=r"'v_x' stays at 10 .* 8 s"):
        check(log)


@pytest.mark.parametrize("quantity", ["v_x", "v_y", "omega", "delta", "a_x"])
def test_pauses_do_not_hide_a_stuck_sensor(quantity: str) -> None:
    log = plant_log()
    log["time"] += 60.0 * (np.arange(1500) // 150)  # a pause after every 3 s
    check(log)
    log[quantity][500:900] = log[quantity][500]
    with pytest.raises(EgpError, match=f"'{quantity}' stays at .* 8 s"):
        check(log)
