"""Importing logs: units, periods, and the mistakes people make with them."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

import log_faults
import numpy as np
import polars as pl
import pytest
from surfaces import provenance
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service.cli import app
from egp_service.data.coverage import Coverage
from egp_service.data.dataset import Dataset
from egp_service.data.log_import import Column, import_log
from egp_service.data.table import numbers, read_table

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


MASS = 1400.0
COLUMNS = {
    "time": "t:ms",
    "v_x": "speed:km/h",
    "v_y": "drift:m/s",
    "omega": "yaw_rate:deg/s",
    "delta": "wheel:deg",
    "a_x": "accel:g",
}


def _log(period: float = 0.01, seconds: float = 30.0) -> dict[str, NDArray[np.float64]]:
    """Return SI signals of a smooth drive."""
    t = np.arange(round(seconds / period)) * period
    return {
        "t": t,
        "v_x": 15.0 + 3.0 * np.sin(0.3 * t),
        "v_y": 0.2 * np.sin(0.8 * t),
        "omega": 0.3 * np.sin(0.8 * t),
        "delta": 0.1 * np.sin(0.8 * t),
        "a_x": 0.9 * np.cos(0.3 * t),
    }


def _write(path: Path, si: dict[str, NDArray[np.float64]]) -> None:
    pl.DataFrame(
        {
            "t": 1e3 * si["t"],
            "speed": 3.6 * si["v_x"],
            "drift": si["v_y"],
            "yaw_rate": np.rad2deg(si["omega"]),
            "wheel": np.rad2deg(si["delta"]),
            "accel": si["a_x"] / 9.80665,
        }
    ).write_csv(path)


def _import(path: Path, **changes: str) -> Dataset:
    columns = {name: Column.parse(text) for name, text in (COLUMNS | changes).items()}
    return import_log(path, columns, provenance(), mass=MASS)


def test_converts_units_and_thins_to_the_period(tmp_path: Path) -> None:
    si = _log()
    _write(tmp_path / "drive.csv", si)
    dataset = _import(tmp_path / "drive.csv")
    # 10 ms rows, dt 50 ms: state at every fifth row, force averaged over the period.
    np.testing.assert_allclose(dataset.z[0, 0], si["v_x"][0], rtol=1e-12)
    np.testing.assert_allclose(
        dataset.z[1, :4], [si[q][5] for q in ("v_x", "v_y", "omega", "delta")]
    )
    np.testing.assert_allclose(dataset.z[0, 4], MASS * si["a_x"][:5].mean(), rtol=1e-12)
    np.testing.assert_allclose(dataset.z[0, 5], (si["delta"][5] - si["delta"][0]) / 0.05)
    np.testing.assert_allclose(dataset.y[0, 0], si["v_x"][5] - si["v_x"][0])
    # Ten-second trajectories, in which each row begins where the last one ended.
    assert len(np.unique(dataset.trajectory)) == 3
    same = dataset.trajectory[1:] == dataset.trajectory[:-1]
    np.testing.assert_allclose((dataset.z[:-1, :3] + dataset.y[:-1])[same], dataset.z[1:, :3][same])


def test_doubts_units(tmp_path: Path) -> None:
    _write(tmp_path / "drive.csv", _log())
    with pytest.raises(EgpError, match=r"delta reaches 5\.73 rad .* check the unit"):
        _import(tmp_path / "drive.csv", delta="wheel:rad")
    with pytest.raises(EgpError, match="v_x from 'speed': rad is not a unit of v_x"):
        _import(tmp_path / "drive.csv", v_x="speed:rad")
    with pytest.raises(EgpError, match="unknown unit 'kmh'"):
        Column.parse("speed:kmh")
    with pytest.raises(EgpError, match="expected COLUMN:UNIT"):
        Column.parse("speed")


def test_two_quantities_of_one_column_are_an_error(tmp_path: Path) -> None:
    _write(tmp_path / "drive.csv", _log())
    with pytest.raises(EgpError, match="v_x and v_y are both the column 'speed': expected a col"):
        _import(tmp_path / "drive.csv", v_y="speed:km/h")


def test_compares_a_logged_steering_rate(tmp_path: Path) -> None:
    si = _log()
    _write(tmp_path / "drive.csv", si)
    rate = np.gradient(np.rad2deg(si["delta"]), si["t"])
    frame = pl.read_csv(tmp_path / "drive.csv").with_columns(rate=rate)
    frame.write_csv(tmp_path / "drive.csv")
    _import(tmp_path / "drive.csv", delta_dot="rate:deg/s")
    with pytest.raises(EgpError, match="check both units"):
        _import(tmp_path / "drive.csv", delta_dot="rate:rad/s")
    # A piece behind a gap in which the wheels only seem to move, by the sensor's resolution.
    t = pl.col("t")
    noise = pl.when(t > 2.8e4).then(0.1 * (t // 50 % 2)).otherwise(pl.col("wheel"))
    still = pl.when(t > 2.8e4).then(0.0).otherwise(pl.col("rate"))
    broken = frame.filter((t < 2.7e4) | (t > 2.8e4))
    broken.with_columns(wheel=noise, rate=still).write_csv(tmp_path / "broken.csv")
    _import(tmp_path / "broken.csv", delta_dot="rate:deg/s")


def test_doubts_time(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    _write(path, _log(period=0.03))
    with pytest.raises(EgpError, match=r"period is 0\.03 s: dt 0\.05 s is no multiple"):
        _import(path)
    si = _log()
    si["t"][100] = si["t"][99]
    _write(path, si)
    with pytest.raises(EgpError, match="does not increase"):
        _import(path)
    si = _log()
    si["t"] += np.cumsum(np.random.default_rng(0).uniform(0.0, 0.01, len(si["t"])))
    _write(path, si)
    with pytest.raises(EgpError, match="resample the log"):
        _import(path)
    _write(path, _log(seconds=0.05))
    with pytest.raises(EgpError, match="unbroken stretch"):
        _import(path)


def test_time_is_checked_before_what_depends_on_it(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    si = _log(period=0.02)
    _write(path, si | {"t": np.floor(si["t"])})  # 50 rows in a second have the same time
    with pytest.raises(EgpError, match=r"time does not increase at row 1: .* more digits"):
        _import(path)
    for rows in (0, 1):
        _write(path, {name: values[:rows] for name, values in si.items()})
        with pytest.raises(EgpError, match=f"the log has {rows} rows: expected at least two"):
            _import(path)


@pytest.mark.parametrize("separator", ["", ";;", "\n", "·"])
def test_a_separator_is_one_character(tmp_path: Path, separator: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t;v\n", encoding="utf-8")
    columns = {name: Column.parse(text) for name, text in COLUMNS.items()}
    with pytest.raises(EgpError, match="one ASCII character as --separator"):
        import_log(path, columns, provenance(), mass=MASS, separator=separator)


def test_names_what_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    si = _log()
    si["omega"][7] = np.nan
    _write(path, si)
    with pytest.raises(EgpError, match="column 'yaw_rate', row 7"):
        _import(path)
    _write(path, _log())
    with pytest.raises(EgpError, match="no column 'velocity', found t, speed"):
        _import(path, v_x="velocity:m/s")
    with pytest.raises(EgpError, match="exactly one of F_x and a_x"):
        _import(path, F_x="accel:N")
    columns = {name: Column.parse(text) for name, text in COLUMNS.items()}
    with pytest.raises(EgpError, match="mass in kg"):
        import_log(path, columns, provenance())
    path.write_text("t,speed\n1,fast\n")
    columns["v_x"] = Column.parse("speed:m/s")
    with pytest.raises(EgpError, match="column 'speed', row 0 holds 'fast'"):
        import_log(path, columns, provenance(), mass=MASS)


def _refused(path: Path, si: dict[str, NDArray[np.float64]], **changes: str) -> str:
    _write(path, si)
    with pytest.raises(EgpError) as caught:
        _import(path, **changes)
    return str(caught.value)


def test_seconds_that_are_read_as_milliseconds_are_an_error(tmp_path: Path) -> None:
    si = _log()
    si["t"] = 1e-3 * si["t"]
    text = _refused(tmp_path / "drive.csv", si)
    assert text.startswith("'t' read in ms gives a row every 1e-05 s")
    assert "--column time=t:s" in text


def test_speeds_that_are_read_in_another_unit_are_an_error(tmp_path: Path) -> None:
    si = _log()
    si["omega"] = 0.1 * si["omega"]  # the steering is not excited enough to show it
    si["delta"] = 0.1 * si["delta"]
    slow = si | {"v_x": si["v_x"] / 3.6}
    text = _refused(tmp_path / "slow.csv", slow)
    assert "'speed' and 'accel' contradict each other: the speed changes 0.28 times" in text
    fast = si | {"v_x": si["v_x"] * 3.6}
    assert "3.6 times" in _refused(tmp_path / "fast.csv", fast)


@pytest.mark.parametrize(
    ("quantity", "factor", "complaint"),
    [
        ("omega", -1.0, "have opposite signs"),
        ("delta", -1.0, "have opposite signs"),
        ("delta", 8.0, "--steering-ratio"),
        ("omega", 0.1, "fit a wheelbase of 53.1 m"),
        ("a_x", -1.0, "slows down when it accelerates"),
        ("a_x", 3.0, "0.33 times as fast"),
    ],
)
def test_columns_that_contradict_each_other_are_an_error(
    tmp_path: Path, quantity: str, factor: float, complaint: str
) -> None:
    si = _log()
    si[quantity] = factor * si[quantity]
    assert complaint in _refused(tmp_path / "drive.csv", si)


def test_swapped_speeds_are_an_error(tmp_path: Path) -> None:
    si = _log()
    si["v_x"], si["v_y"] = si["v_y"], si["v_x"]
    text = _refused(tmp_path / "drive.csv", si)
    assert "'speed' and 'drift' are probably swapped" in text


def test_an_outlier_is_an_error_with_its_row(tmp_path: Path) -> None:
    si = _log()
    si["v_x"][700] = 99.0
    text = _refused(tmp_path / "drive.csv", si)
    assert "'speed' jumps from" in text
    assert "to 99 (SI units) at row 700" in text


def test_a_stuck_sensor_is_an_error_with_its_rows(tmp_path: Path) -> None:
    si = _log()
    si["v_y"][1000:1800] = 0.12
    text = _refused(tmp_path / "drive.csv", si)
    assert "'drift' stays at 0.12 (SI units) from row 1000 to 1799, 8 s" in text
    quiet = _log()
    for quantity in ("v_y", "omega", "delta", "a_x"):
        quiet[quantity][:] = 0.0
    quiet["v_x"][:] = 15.0  # straight ahead, where nothing need change
    _write(tmp_path / "quiet.csv", quiet)
    assert len(_import(tmp_path / "quiet.csv")) > 0


def test_the_steering_wheels_angle_is_divided_by_its_ratio(tmp_path: Path) -> None:
    si = _log()
    _write(tmp_path / "drive.csv", si)
    expected = _import(tmp_path / "drive.csv")
    # 1.8 rad are plausible of the steering wheel, and not of the road wheels.
    _write(tmp_path / "wheel.csv", si | {"delta": 18.0 * si["delta"]})
    columns = {name: Column.parse(text) for name, text in COLUMNS.items()}
    found = import_log(tmp_path / "wheel.csv", columns, provenance(), mass=MASS, steering_ratio=18)
    np.testing.assert_allclose(found.z, expected.z, rtol=1e-9, atol=1e-12)
    with pytest.raises(EgpError, match="positive --steering-ratio"):
        import_log(tmp_path / "wheel.csv", columns, provenance(), mass=MASS, steering_ratio=0.0)
    with pytest.raises(EgpError, match=r"delta reaches 1\.8 rad .* state --steering-ratio"):
        _import(tmp_path / "wheel.csv")


def test_spreadsheets_of_other_countries(tmp_path: Path) -> None:
    _write(tmp_path / "drive.csv", _log())
    text = (tmp_path / "drive.csv").read_text()
    other = "\ufeff" + text.replace(",", ";").replace(".", ",")
    (tmp_path / "comma.csv").write_text(other, encoding="utf-8")
    np.testing.assert_array_equal(
        _import(tmp_path / "comma.csv").z, _import(tmp_path / "drive.csv").z
    )
    (tmp_path / "tabs.csv").write_text(text.replace(",", "\t"))
    np.testing.assert_array_equal(
        _import(tmp_path / "tabs.csv").z, _import(tmp_path / "drive.csv").z
    )


def test_columns_whose_names_differ_by_spaces_are_an_error(tmp_path: Path) -> None:
    _write(tmp_path / "log.csv", _log())
    text = (tmp_path / "log.csv").read_text().replace("drift", "speed ", 1)
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(EgpError, match=r"log\.csv: two columns are named 'speed'"):
        _import(tmp_path / "log.csv")


def test_the_first_point_in_time_may_be_missing(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    at = datetime(2026, 1, 1, tzinfo=UTC)
    for times in ([None, at], [None, None]):
        pl.DataFrame({"t": pl.Series(times, dtype=pl.Datetime)}).write_parquet(path)
        with pytest.raises(EgpError, match="column 't', row 0 is empty"):
            numbers(path, read_table(path)["t"])


def test_a_bad_cell_is_named(tmp_path: Path) -> None:
    _write(tmp_path / "drive.csv", _log())
    lines = (tmp_path / "drive.csv").read_text().splitlines()
    for content, found in (("n/a", "holds 'n/a'"), ("", "is empty"), ("inf", "holds")):
        cells = lines[7].split(",")
        cells[1] = content
        changed = [*lines[:7], ",".join(cells), *lines[8:]]
        (tmp_path / "bad.csv").write_text("\n".join(changed))
        with pytest.raises(EgpError, match=f"column 'speed', row 6 {found}"):
            _import(tmp_path / "bad.csv")


@pytest.mark.parametrize("seed", [2, 3])
def test_mistakes_are_found_in_a_drive_and_none_in_sound_ones(tmp_path: Path, seed: int) -> None:
    # `python tests/train/log_faults.py` imports 40 logs of each kind.
    rng = np.random.default_rng(seed)
    log = log_faults.drive(seed)
    for sound in (log, log_faults.noisy(log, rng)):
        assert log_faults.verdict(sound, tmp_path) is None
    kinds = log_faults.FAULTS.items()
    accepted = [kind for kind, do in kinds if log_faults.verdict(do(log, rng), tmp_path) is None]
    assert accepted == []


@pytest.mark.parametrize("kind", ["m/s read as km/h", "km/h read as m/s"])
def test_a_speed_in_the_wrong_unit_is_found_without_the_mass(tmp_path: Path, kind: str) -> None:
    rng = np.random.default_rng(1)
    for seed in (0, 2):  # on friction 1.1 and 0.5
        log = log_faults.noisy(log_faults.drive(seed), rng)
        assert log_faults.verdict(log, tmp_path, mass_known=False) is None
        wrong = log_faults.FAULTS[kind](log, rng)
        error = log_faults.verdict(wrong, tmp_path, mass_known=False)
        assert error is not None
        assert "wheelbase" in error
        assert "wrong unit" in error


def test_a_known_wheelbase_sharpens_the_checks(tmp_path: Path) -> None:
    si = _log()
    si["omega"] = si["v_x"] * si["delta"] / 0.33  # of a model car
    si["omega"], si["delta"] = si["omega"] / 2.0, si["delta"] / 2.0
    _write(tmp_path / "drive.csv", si)
    columns = {name: Column.parse(text) for name, text in COLUMNS.items()}
    with pytest.raises(EgpError, match=r"fit a wheelbase of 0\.33 m, expected 1 to 16\.8 m"):
        import_log(tmp_path / "drive.csv", columns, provenance(), mass=MASS)
    import_log(tmp_path / "drive.csv", columns, provenance(), mass=MASS, wheelbase=0.33)
    with pytest.raises(EgpError, match=r"fit a wheelbase of 0\.33 m, expected 0\.6 to"):
        import_log(tmp_path / "drive.csv", columns, provenance(), mass=MASS, wheelbase=1.0)


def test_the_summary_counts_the_gaps_of_all_logs(tmp_path: Path) -> None:
    arguments = ["collect", "--friction", "0.5", "--dt", "0.05", "--mass", str(MASS)]
    arguments += ["-o", str(tmp_path / "data.parquet")]
    for quantity, column in COLUMNS.items():
        arguments += ["--column", f"{quantity}={column}"]
    log = _log(seconds=30.0)
    _write(tmp_path / "whole.csv", log)
    command = [*arguments, "--from-log", str(tmp_path / "whole.csv")]
    whole = CliRunner().invoke(app, command)
    assert whole.exit_code == 0, whole.output
    assert "in total" not in whole.output
    # A log with gaps of 1.5 and 2.5 s, beside one with a gap of 1.5 s.
    for name, ends in (("a.csv", ((5.0, 6.5), (12.0, 14.5))), ("b.csv", ((5.0, 6.5),))):
        time = np.asarray(log["t"])
        kept = np.all([(time <= first) | (time >= last) for first, last in ends], axis=0)
        _write(tmp_path / name, {column: np.asarray(log[column])[kept] for column in log})
        arguments += ["--from-log", str(tmp_path / name)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "3 gaps of 5.5 s in total, the longest of 2.5 s" in result.output


def test_several_logs_and_what_they_cover(tmp_path: Path) -> None:
    arguments = ["collect", "--friction", "0.5", "--dt", "0.05", "--mass", str(MASS)]
    for name, seconds in (("a.csv", 30.0), ("b.csv", 20.0)):
        _write(tmp_path / name, _log(seconds=seconds))
        arguments += ["--from-log", str(tmp_path / name)]
    for quantity, column in COLUMNS.items():
        arguments += ["--column", f"{quantity}={column}"]
    output, picture = tmp_path / "data.parquet", tmp_path / "covered.png"
    command = [*arguments, "-o", str(output), "--picture", str(picture)]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    data = Dataset.read(output)
    assert data.provenance.vehicle == "unnamed"
    covered = Coverage.of(data)
    assert covered.time.sum() == pytest.approx(covered.seconds) == pytest.approx(0.05 * len(data))
    # Speeds are 12 to 18 m/s, the yaw rate reaches 0.3 rad/s: at most 5.4 m/s².
    assert covered.time[[2, 3]].sum() == pytest.approx(covered.seconds)
    assert covered.time[:, 5:].sum() == 0.0
    assert f"{covered.seconds:.3g} s in 5 trajectories of at most" in result.output
    assert picture.stat().st_size > 10_000
    (tmp_path / "b.csv").write_text("t,speed\n")
    refused = CliRunner().invoke(app, command)
    assert "b.csv" in str(refused.exception)
