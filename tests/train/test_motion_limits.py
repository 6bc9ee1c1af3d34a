"""Motions that no road vehicle makes, though each value of the log is plausible."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from plant_log import COLUMNS, MASS, options, plant_log
from surfaces import provenance
from typer.testing import CliRunner

from egp_service import EgpError, VehicleParameters
from egp_service.cli import app
from egp_service.control.toml_text import dumps
from egp_service.data import motion_limits, plausibility
from egp_service.data.alignment import consecutive
from egp_service.data.log_import import import_log
from egp_service.training.train import check_magnitudes

if TYPE_CHECKING:
    from pathlib import Path

    from plant_log import Log


def check(log: Log) -> None:
    motion_limits.check(log, COLUMNS)


def test_a_lateral_acceleration_of_several_g_is_an_error() -> None:
    log = plant_log()
    check(log)
    # As of a spin whose v_y is in the place of the yaw rate.
    log["omega"][700:720] = 4.0
    with pytest.raises(EgpError, match=r"exceeds [3-9]\.\d g in 0\.5% .* 'omega' and 'v_y' are"):
        check(log)
    log["omega"][703:720] = 0.0
    check(log)  # three rows of 1500 are outliers


def test_a_steering_angle_that_fails_for_seconds_is_an_error(tmp_path: Path) -> None:
    log = plant_log()
    log["delta"] += 0.15
    check(log)
    log["delta"][600:800] = 0.0
    command = ["collect", *options(tmp_path / "log.csv", log), "-o", str(tmp_path / "a.parquet")]
    result = CliRunner().invoke(app, command)
    assert "'delta' stays at 0 rad from row 600 to 799, 4.0 s, and jumps" in str(result.exception)
    # A pause during which the wheels were turned is no jump.
    log["time"][600:] += 3.0
    log["time"][800:] += 3.0
    check(log)


def test_single_outliers_of_the_steering_angle_are_none() -> None:
    log = plant_log()
    log["delta"][[300, 900]] += 0.2
    check(log)
    log["delta"][::50] += 0.2
    with pytest.raises(EgpError, match=r"changes faster than 6 rad/s in 3\.9% of the rows"):
        check(log)


def test_transitions_to_and_from_single_outliers_are_left_out(tmp_path: Path) -> None:
    log = plant_log()
    found = []
    for outliers in ([], [300, 900, 901]):
        log["delta"][outliers] += 0.2
        options(tmp_path / "log.csv", log)
        found.append(import_log(tmp_path / "log.csv", COLUMNS, provenance(dt=0.02), mass=MASS))
    clean, data = found
    assert len(clean) - len(data) == 2 + 2  # from 900 to 901 the angle does not jump
    assert data.gaps == pytest.approx([0.04, 0.02, 0.02])
    assert len(consecutive(data)) == len(consecutive(clean)) + 3
    car = VehicleParameters.commonroad(1)
    check_magnitudes(data, car)
    wrong = replace(data, z=data.z + np.array([0, 0, 0, 0, 0, 13.0]))
    with pytest.raises(EgpError, match=r"delta_dot is 1.* more than 6: remove such rows"):
        check_magnitudes(wrong, car)
    check_magnitudes(wrong, None)  # it may be that of a small vehicle


def test_small_vehicles_turn_and_steer_faster(tmp_path: Path) -> None:
    assert plausibility.largest("omega", None) == plausibility.largest("omega", 2.4) == 6.0
    assert plausibility.largest("omega", 0.5) == plausibility.largest("delta_dot", 0.5) == 12.0
    assert plausibility.largest("v_x", 0.5) == plausibility.largest("v_x", None)
    log = plant_log()
    log["omega"] *= 8.0 / np.abs(log["omega"]).max()
    command = ["collect", *options(tmp_path / "log.csv", log), "-o", str(tmp_path / "a.parquet")]
    result = CliRunner().invoke(app, command)
    assert "omega reaches 8 rad/s" in str(result.exception)
    car = VehicleParameters.commonroad(1).fields()
    small = {"l_f": 0.2, "l_r": 0.3, "mass": 10.0, "yaw_inertia": 0.6, "width": 0.3}
    (tmp_path / "car.toml").write_text(dumps(car | small), encoding="utf-8")
    mass = command.index("--mass")
    del command[mass : mass + 2]  # the file states it
    command += ["--vehicle", str(tmp_path / "car.toml")]
    assert "reaches" not in str(CliRunner().invoke(app, command).exception)


def test_coarse_steps_of_the_steering_angle_are_no_failure() -> None:
    log = plant_log()
    log["delta"] = np.deg2rad(np.round(np.rad2deg(log["delta"])))
    check(log)
