"""Time stamps of logs: which period they have, and where they break the log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from plant_log import COLUMNS, MASS
from surfaces import provenance

from egp_service import EgpError
from egp_service.data.alignment import consecutive
from egp_service.data.channels import channels
from egp_service.data.dataset import Dataset
from egp_service.data.log_import import import_log
from egp_service.training.train import split

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def imported(
    folder: Path, time: NDArray[np.float64], stamps: NDArray[np.float64], dt: float
) -> Dataset:
    """Import a smooth drive whose rows were measured at `time` and have these stamps, s."""
    steering = np.sin(0.8 * time)
    columns = (
        stamps,
        15.0 + 3.0 * np.sin(0.3 * time),
        0.2 * steering,
        0.3 * steering,
        0.1 * steering,
        0.9 * np.cos(0.3 * time),
    )
    pl.DataFrame(dict(zip(COLUMNS, columns, strict=True))).write_csv(folder / "log.csv")
    return import_log(folder / "log.csv", COLUMNS, provenance(dt=dt), mass=MASS)


# Stamps in whole ms at 150 Hz are 6, 7 and 7 ms apart, of which the median is no period.
@pytest.mark.parametrize(
    ("rate", "resolution", "dt"),
    [(150, 1e-3, 0.02), (120, 1e-3, 0.025), (400, 1e-3, 0.02), (30, 1e-2, 0.1), (100, 1e-2, 0.05)],
)
def test_the_period_of_rounded_stamps_is_that_of_the_log(
    tmp_path: Path, rate: int, resolution: float, dt: float
) -> None:
    time = np.arange(40 * rate) / rate
    stamps = resolution * np.round(time / resolution)
    data = imported(tmp_path, time, stamps, dt)
    assert data.gaps == ()
    assert dt * len(data) == pytest.approx(40.0, abs=dt)
    for missing in (2, 3):  # as many rows break the log, although their neighbours are rounded
        kept = np.r_[0:1000, 1000 + missing - 1 : len(time)]
        (gap,) = imported(tmp_path, time[kept], stamps[kept], dt).gaps
        assert gap == pytest.approx(missing / rate, abs=1.01 * resolution)


def test_a_period_that_is_not_quite_dt_is_an_error_that_names_it(tmp_path: Path) -> None:
    time = np.arange(2000) / 49.1
    with pytest.raises(EgpError, match=r"is 0\.0203666 s: dt 0\.02 s .* choose --dt 0\.0203666 or"):
        imported(tmp_path, time, time, 0.02)
    assert len(imported(tmp_path, time, time, 0.0203666)) == 1999
    time = np.arange(6000) / 150.0
    with pytest.raises(EgpError, match=r"period is 0\.00666\d+ s: .* choose --dt 0\.0\d+ or"):
        imported(tmp_path, time, np.round(time, 3), 0.021)
    close = np.arange(2000) / 50.1
    assert len(imported(tmp_path, close, close, 0.02)) == 1999


def test_late_stamps_do_not_make_more_trajectories(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    time = 0.02 * np.arange(9000.0)
    late = rng.random(len(time)) < 0.03
    data = imported(tmp_path, time, time + 0.006 * late, 0.02)
    assert len(np.unique(data.trajectory)) == 18
    runs = consecutive(data)
    assert len(runs) > 200
    for rows in runs:  # nothing leads across a stamp that is late
        states = data.z[rows, :3]
        np.testing.assert_allclose(states[:-1] + data.y[rows[:-1]], states[1:], atol=1e-12)
        assert np.abs(np.diff(states[:, 0])).max(initial=0.0) < 0.9 * 0.02 + 1e-9
    # Where the log is even, trajectories are those of a log without such stamps.
    even = imported(tmp_path, time, time, 0.02)
    assert len(np.unique(even.trajectory)) == 18
    assert np.array_equal(even.step, np.arange(len(even)) % 500)
    _, first = np.unique(data.trajectory, return_index=True)
    np.testing.assert_array_equal(data.step[first], 0)
    # Held-out rows have no training rows beside them but at the ends of 10 s.
    training, held = split(data, 0.2, np.random.default_rng(0))
    assert len(held) > 1000
    assert not set(training.trajectory) & set(held.trajectory)


def test_a_gap_breaks_the_log(tmp_path: Path) -> None:
    time = 0.01 * np.arange(3000.0)
    time[300:] += 2.0
    data = imported(tmp_path, time, time, 0.05)
    assert data.gaps == pytest.approx((2.01,))
    # Trajectories end at 10, 20 and 30 s of the log, however much of this time the gap takes.
    assert np.unique(data.trajectory).tolist() == [0, 1, 2, 3]
    assert [len(rows) for rows in consecutive(data)] == [59, 100, 200, 200, 39]
    assert np.abs(data.y[:, 0]).max() < 0.1  # nothing across the gap


def test_channels_are_told_by_consecutive_transitions_only() -> None:
    n = 2000
    states = 0.1 * np.random.default_rng(0).standard_normal((n + 1, 3)) + [15.0, 0.0, 0.0]
    z = np.hstack([states[:-1], np.random.default_rng(1).standard_normal((n, 3))])
    index = np.arange(n, dtype=np.uint32)
    data = Dataset(z, np.diff(states, axis=0), np.zeros_like(index), index, provenance())
    whole = channels(data)
    np.testing.assert_allclose(whole.autocorrelation, -0.5, atol=0.05)
    assert np.isfinite(whole.force_delay)
    # Every second transition: none continues the one before it.
    apart = channels(data.select(np.arange(0, n, 2)))
    assert np.isnan([*apart.autocorrelation, apart.steering_delay, apart.force_delay]).all()
    # Runs of 1 s in one trajectory do not tell delays of up to 1 s.
    broken = channels(Dataset(z, data.y, data.trajectory, index + index // 20, provenance()))
    assert np.isnan([broken.steering_delay, broken.force_delay]).all()
    np.testing.assert_allclose(broken.noise, whole.noise, rtol=0.2)
