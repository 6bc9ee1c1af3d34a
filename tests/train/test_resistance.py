"""What slows a car beside its tyres: gravity on a tilted road, rolling resistance and drag."""

from __future__ import annotations

import dataclasses
import re
from typing import TYPE_CHECKING

import log_faults
import numpy as np
import polars as pl
import pytest
from surfaces import provenance
from typer.testing import CliRunner

from egp_service import EgpError, Plant
from egp_service.cli import app
from egp_service.data.channels import channels
from egp_service.data.dataset import Dataset, merge
from egp_service.data.log_import import Column, import_log
from egp_service.data.sensors import Sensors, measure
from egp_service.quantities import TILT
from egp_service.training.open_loop import skill
from egp_service.training.prior_mean import PriorMean
from egp_service.training.vehicle_fit import fit_vehicle
from egp_service.vehicle import known_vehicle

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from egp_service.training.vehicle_fit import FittedVehicle

DT = 0.02
CAR = known_vehicle("commonroad-1")
COLUMNS = log_faults.UNITS | TILT
ROLLING, DRAG = 0.2, 5e-4
TILTS = [(-0.08, -0.15), (0.0, 0.0), (0.08, 0.15)]


def _drive(tilt: tuple[float, float], seed: int, speed: float = 15.0) -> pl.DataFrame:
    """Return 30 s of a car on a road with grade and bank `tilt`, at about this speed in m/s.

    It is the simulated car, whose force loses the resistance that a real one has.
    """
    grade, bank = tilt
    car = Plant(disturbances={"grade": grade, "bank": bank})
    car.reset(0.0, 0.0, 0.0, speed - 1.0)
    rows = []
    for k in range(1500):
        _, _, v_x, _, v_y, omega, delta = car.vehicle_state
        wanted = 0.06 * (15.0 / speed) ** 2 * np.sin(0.06 * k + seed) * min(k / 100, 1.0)
        rate = float(np.clip((wanted - delta) / 0.1, -0.4, 0.4))
        resistance = ROLLING + DRAG * v_x**2
        a = 9.81 * np.sin(grade) + resistance + 1.5 * np.sin(0.05 * k) + 0.5 * (speed - v_x)
        rows.append([DT * k, v_x, v_y, omega, delta, CAR.mass * a, grade, bank])
        car.step(np.array([CAR.mass * (a - resistance), rate]), DT, 0.8)
    return pl.DataFrame(np.array(rows), schema=list(COLUMNS), orient="row")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("tilted")
    for number, tilt in enumerate(TILTS):
        _drive(tilt, number).write_csv(folder / f"{number}.csv")
    return [folder / f"{number}.csv" for number in range(len(TILTS))]


def _imported(logs: list[Path], without: tuple[str, ...] = ()) -> Dataset:
    columns = {name: Column(name, u) for name, u in COLUMNS.items() if name not in without}
    about = dataclasses.replace(provenance(), dt=DT, vehicle="own car")
    return merge([import_log(p, columns, dataclasses.replace(about, method=p.name)) for p in logs])


def _fitted(data: Dataset) -> FittedVehicle:
    (found,) = fit_vehicle([data], CAR, [np.random.default_rng(0)])
    return found


def _after_a_second(vehicle: FittedVehicle, data: Dataset) -> NDArray[np.float64]:
    """Return the RMS errors (3,) of a fitted vehicle after 1 s."""
    compared = skill(
        {"fitted": lambda z: PriorMean(vehicle.values, vehicle.steps).predict(z, DT)}, data
    )
    return np.asarray(compared.rms["fitted"][compared.durations.index(1.0)])


def test_a_vehicle_is_fitted_to_tilted_roads_if_the_tilt_was_measured(logs: list[Path]) -> None:
    level, tilted = _imported(logs), _imported(logs, ("grade", "bank"))
    vehicle = _fitted(level)
    known, unknown = _after_a_second(vehicle, level), _after_a_second(_fitted(tilted), tilted)
    # Errors in m/s, m/s and rad/s: 0.026, 0.027, 0.007 with the tilt, 0.45, 0.13, 0.028 without.
    assert np.all(known <= [0.1 * unknown[0], 0.25 * unknown[1], 0.4 * unknown[2]])
    fitted = {parameter.name: parameter.value for parameter in vehicle.parameters}
    assert min(fitted["D_f"], fitted["D_r"]) == pytest.approx(0.66, abs=0.1)
    at_15 = fitted["c_0"] + 225.0 * fitted["c_2"]
    assert at_15 == pytest.approx(ROLLING + 225.0 * DRAG, abs=0.03)


def test_drag_is_known_at_speeds_beyond_the_data(tmp_path: Path) -> None:
    drives = {"slow": 9.0, "middle": 13.0, "quick": 17.0, "fast": 27.0}
    for number, (name, speed) in enumerate(drives.items()):
        _drive((0.0, 0.0), number, speed).write_csv(tmp_path / f"{name}.csv")
    *slow, fast = (tmp_path / f"{name}.csv" for name in drives)
    data, faster = _imported(slow), _imported([fast])
    # Data that are said to have their force from the acceleration are fitted without resistance.
    stated = dataclasses.replace(data.provenance, force_from_a_x=True)
    without = _fitted(dataclasses.replace(data, provenance=stated))
    assert len(without.values) == 17
    known, unknown = (_after_a_second(found, faster) for found in (_fitted(data), without))
    # 0.02 and 0.52 m/s.
    assert known[0] < 0.2 * unknown[0]


def test_changes_are_those_of_a_level_road(logs: list[Path]) -> None:
    data, raw = _imported(logs), _imported(logs, ("grade", "bank"))
    assert data.tilt is not None
    assert raw.tilt is None
    np.testing.assert_array_equal(data.z, raw.z)
    np.testing.assert_allclose(data.y + data.by_gravity, raw.y, rtol=0.0, atol=1e-15)
    grade, bank = data.tilt[-1]
    assert (grade, bank) == pytest.approx(TILTS[-1])
    expected = [-9.81 * DT * np.sin(grade), -9.81 * DT * np.cos(grade) * np.sin(bank), 0.0]
    np.testing.assert_allclose(data.by_gravity[-1], expected)
    # The measured states lead to each other only with gravity.
    np.testing.assert_array_equal(channels(data).noise, channels(raw).noise)
    alone = _imported(logs, ("bank",))
    assert alone.tilt is not None
    np.testing.assert_array_equal(alone.tilt[:, 1], 0.0)
    np.testing.assert_array_equal(alone.y[:, 1], raw.y[:, 1])
    exact = Sensors(noise=(0.0, 0.0, 0.0), quantum=(1e-12,) * 3, cutoff=1e6, delay=0)
    seen = measure(data, exact, np.random.default_rng(0))
    np.testing.assert_allclose(seen.y, data.y, atol=1e-9)


def test_a_file_states_the_tilt(logs: list[Path], tmp_path: Path) -> None:
    data = _imported(logs)
    data.write(tmp_path / "tilted.parquet")
    read = Dataset.read(tmp_path / "tilted.parquet")
    assert read.tilt is not None
    assert data.tilt is not None
    np.testing.assert_array_equal(read.tilt, data.tilt)
    np.testing.assert_array_equal(read.y, data.y)
    np.testing.assert_array_equal(read.select(np.array([5, 2000])).tilt, data.tilt[[5, 2000]])
    damaged = data.tilt.copy()
    damaged[7, 1] = np.nan
    with pytest.raises(EgpError, match="column bank, row 7 is nan"):
        dataclasses.replace(data, tilt=damaged)
    with pytest.raises(EgpError, match=r"tilt has shape \(7, 2\)"):
        dataclasses.replace(data, tilt=data.tilt[:7])
    frame = pl.read_parquet(tmp_path / "tilted.parquet").drop("bank")
    metadata = pl.read_parquet_metadata(tmp_path / "tilted.parquet")
    frame.write_parquet(tmp_path / "lost.parquet", metadata={"egp": metadata["egp"]})
    with pytest.raises(EgpError, match="column bank is missing"):
        Dataset.read(tmp_path / "lost.parquet")


def test_logs_with_and_without_a_tilt_are_not_joined(logs: list[Path]) -> None:
    level = _imported(logs[:1], ("grade", "bank"))
    with pytest.raises(EgpError, match=r"1 of 2 datasets .* state the road's grade or bank"):
        merge([level, _imported(logs[1:2])])


def test_an_implausible_tilt_is_an_error(logs: list[Path], tmp_path: Path) -> None:
    named = [f"--column={q}={q}:{u}" for q, u in COLUMNS.items() if q != "bank"]
    command = ["collect", "-o", str(tmp_path / "out.parquet"), "--friction", "0.8"]
    log = pl.read_csv(logs[0]).with_columns(tilt=pl.col("time"))
    log.write_csv(tmp_path / "log.csv")
    command += ["--from-log", str(tmp_path / "log.csv"), *named]
    result = CliRunner().invoke(app, [*command, "--column=bank=tilt:rad"])
    text = " ".join(str(result.exception).split())
    assert result.exit_code == 1
    assert re.search(r"bank reaches 29.98 rad .* more than 0.7 rad is implausible", text)
    result = CliRunner().invoke(app, [*command, "--column=bank=bank:m/s"])
    assert "m/s is not a unit of bank" in str(result.exception)
    assert not (tmp_path / "out.parquet").exists()
