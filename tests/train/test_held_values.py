"""Columns of a slower sensor, whose values were held until the next ones came."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from plant_log import COLUMNS, MASS, options, plant_log
from surfaces import provenance
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service.cli import app
from egp_service.data.log_import import import_log

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from plant_log import Log

    from egp_service.data.dataset import Dataset

RATE = 16.0  # Hz


def imported(folder: Path, log: Log, dt: float = 0.02) -> Dataset:
    options(folder / "log.csv", log)
    return import_log(folder / "log.csv", COLUMNS, provenance(dt=dt), mass=MASS)


def new_rows(log: Log, rate: float = RATE) -> NDArray[np.bool_]:
    """Return the rows in which a sensor of this rate, Hz, has a new value."""
    return np.diff(np.floor(rate * log["time"] + 1e-9), prepend=-1.0) > 0.0


def held(values: NDArray[np.float64], new: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Keep each new value until the next one."""
    kept: NDArray[np.float64] = values[new][np.cumsum(new) - 1]
    return kept


@pytest.mark.parametrize("quantity", ["v_x", "v_y", "omega"])
def test_held_values_are_an_error_and_interpolated_ones_are_none(
    tmp_path: Path, quantity: str
) -> None:
    log = plant_log()
    new = new_rows(log)
    whole = log[quantity]
    log[quantity] = held(whole, new)
    # 16 Hz in rows of 50 Hz: 34 of 50 repeat the value before them.
    message = rf"'{quantity}' keeps its value in 68% of the periods of 0\.02 s .* --dt 0\.06$"
    with pytest.raises(EgpError, match=message):
        imported(tmp_path, log)
    assert len(imported(tmp_path, log, dt=0.06)) == 499
    log[quantity] = np.interp(log["time"], log["time"][new], whole[new])
    assert len(imported(tmp_path, log)) == 1499


def test_all_held_columns_are_named_with_the_file(tmp_path: Path) -> None:
    log = plant_log()
    for quantity, rate in (("v_x", 25.0), ("v_y", 30.0), ("omega", 10.0)):
        log[quantity] = held(log[quantity], new_rows(log, rate))
    command = ["collect", *options(tmp_path / "log.csv", log), "-o", str(tmp_path / "a.parquet")]
    told = str(CliRunner().invoke(app, command).exception)
    assert told.startswith(f"{tmp_path / 'log.csv'}: 'omega' keeps its value in 80% of the")
    assert "Interpolate 'omega' and 'v_x' and 'v_y' between" in told
    assert told.endswith("--dt 0.1")


def test_states_that_are_all_held_are_found_by_the_force(tmp_path: Path) -> None:
    log = plant_log()
    for quantity in ("v_x", "v_y", "omega", "delta"):
        log[quantity] = held(log[quantity], new_rows(log))
    with pytest.raises(EgpError, match="keeps its value in 68% of"):
        imported(tmp_path, log)


def test_values_that_are_new_in_each_period_are_none(tmp_path: Path) -> None:
    log = plant_log()
    for quantity in ("v_x", "v_y", "omega"):
        log[quantity] = held(log[quantity], new_rows(log, 25.0))
    assert len(imported(tmp_path, log, dt=0.04)) == 749
    with pytest.raises(EgpError, match=r"in 50% of .* --dt 0\.04$"):
        imported(tmp_path, log)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_coarse_values_are_none(tmp_path: Path, noise: float) -> None:
    rng = np.random.default_rng(0)
    exact = plant_log()
    for quantity, quantum in (("v_x", 0.1), ("v_y", 0.01), ("omega", 0.01)):
        for finer in (1.0, 0.5, 0.2, 0.1):
            step = quantum * finer
            values = exact[quantity] + noise * step * rng.standard_normal(1500)
            log = exact | {quantity: step * np.round(values / step)}
            assert len(imported(tmp_path, log)) == 1499


def test_a_straight_road_and_the_steering_are_none(tmp_path: Path) -> None:
    log = plant_log(straight=900)
    for quantity in ("v_y", "omega"):
        log[quantity][:900] = 0.0  # as of a simulator without camber
    log["delta"] = held(log["delta"], new_rows(log))
    assert len(imported(tmp_path, log)) == 1499


def test_a_standing_vehicle_is_none(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    log, rest = plant_log(), 3000
    # The speed is 0 or, as of vibrations, one of up to 0.05 m/s, and the others have noise.
    standing: Log = {name: 1e-3 * rng.standard_normal(rest) for name in log}
    standing["v_x"] = np.where(rng.random(rest) < 0.1, 0.05 * rng.random(rest), 0.0)
    standing["time"] = 0.02 * np.arange(float(rest))
    log["v_x"] -= 8.0 * np.exp(-log["time"])  # starts from standstill
    log["time"] += 0.02 * rest
    assert len(imported(tmp_path, {q: np.concatenate([standing[q], log[q]]) for q in log})) == 4499


def test_few_changes_tell_nothing(tmp_path: Path) -> None:
    log = plant_log()
    log["v_x"] = held(log["v_x"], new_rows(log))
    assert len(imported(tmp_path, {q: values[:100] for q, values in log.items()})) == 99
