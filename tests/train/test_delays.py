"""Delays are compared on the same transitions, whatever the gaps of a log take of each."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from surfaces import TOY

from egp_service import VehicleParameters
from egp_service.data.alignment import Delays, align, available
from egp_service.data.collect import CollectionSettings, collect
from egp_service.data.dataset import Dataset
from egp_service.data.experiment import Experiment
from egp_service.data.provenance import Provenance
from egp_service.data.sensors import Sensors, measure
from egp_service.training import delays
from egp_service.training.delays import find_delays
from egp_service.training.train import TrainingSettings, train

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

DT = 0.04  # 25 Hz
ABOUT = Provenance(DT, "own car", "dry", 1.0, 0, "log", "test")


KART = VehicleParameters(
    **(TOY.fields() | {"mass": 250.0, "yaw_inertia": 90.0, "l_f": 0.55, "l_r": 0.5})
)


@pytest.fixture(autouse=True)
def only_of_the_force() -> Iterator[None]:
    """Leave the delay of the states out, whose fits take longest."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("egp_service.training.delays._vehicle_errors", lambda *_: [0.0])
        yield


def rough_at_the_ends(seed: int, runs: int = 20, periods: int = 250, late: float = 0.0) -> Dataset:
    """Drive straight, on a rough road in the last 0.8 s of runs; the log's force is `late` s."""
    rng = np.random.default_rng(seed)
    step = np.tile(np.arange(periods, dtype=np.uint32), runs)
    time = DT * np.arange(len(step))
    acceleration, logged = (np.sin(2.0 * np.pi / 20.0 * t) for t in (time, time - late))
    noise = np.where(step < periods - 20, 0.5, 5.0) * rng.standard_normal(len(step))
    others = 1e-3 * rng.standard_normal((len(step), 5))
    z = np.zeros((len(step), 6))
    z[:, 0], z[:, 1:4], z[:, 4] = 15.0, others[:, :3], 1000.0 * logged
    y = DT * np.column_stack([acceleration + noise, others[:, 3:]])
    return Dataset(z, y, np.repeat(np.arange(runs, dtype=np.uint32), periods), step, ABOUT)


@pytest.mark.parametrize("seed", [2, 3])
def test_a_delay_is_no_better_because_it_leaves_out_what_is_hard_to_predict(seed: int) -> None:
    # Inputs that are moved by -0.8 s are not in the log where the road is rough.
    assert find_delays([rough_at_the_ends(seed)], None) == Delays()


def test_with_a_constant_mean_a_kart_needs_no_fit_of_a_vehicle(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fit(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr("egp_service.training.delays.fit_vehicle", fit)
    monkeypatch.setattr("egp_service.training.delays._vehicle_errors", fit)
    settings = TrainingSettings(
        mean="constant", max_points=20, first_points=20, restarts=0, max_iterations=3
    )
    log = rough_at_the_ends(2, late=1.2)
    log.z[:, [0, 5]] += 0.01 * np.random.default_rng(0).standard_normal((len(log), 2))
    (member,) = train([log], settings, vehicle=KART)
    assert member.delays is not None
    assert member.delays.measurement == 0.0
    assert member.delays.force == pytest.approx(-1.2, abs=0.1)
    assert "the delay of the measured states is not searched" in caplog.text


def test_delays_that_cannot_be_searched_are_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    log = rough_at_the_ends(2, late=1.2)
    log.z[:, 0] = 2.5
    assert find_delays([log], None) == Delays()
    assert "more than 200 transitions above 5 m/s" in caplog.text
    # At 2.5 m/s a model car drives as fast as others at 6 m/s.
    small = VehicleParameters(
        **TOY.fields() | {"mass": 3.74, "yaw_inertia": 0.047, "l_f": 0.159, "l_r": 0.171}
    )
    caplog.clear()
    moving = log.of_vehicle(small)
    assert moving.least_speed == pytest.approx(5.0 * math.sqrt(0.33 / 2.0))
    assert find_delays([moving], small, may_fit=False).force == pytest.approx(-1.2, abs=0.1)


def test_a_delay_that_leaves_too_few_transitions_does_not_count() -> None:
    long = rough_at_the_ends(2, late=1.2)
    assert find_delays([long], None).force == pytest.approx(-1.2, abs=0.1)
    # Of runs of 2.2 s it leaves 1 s: 500 transitions, of which 100 are held out.
    short = rough_at_the_ends(2, periods=55, late=1.2)
    assert find_delays([short], None) == Delays()


@pytest.mark.parametrize("seed", [0, 4])
def test_a_delay_is_found_in_a_log_that_late_stamps_break(seed: int) -> None:
    rng = np.random.default_rng(seed)
    exact = collect(
        Experiment(0.9, "dry", 1, DT, 1), CollectionSettings(runs=2, samples=0, steady=0), jobs=1
    )
    whole = measure(exact, Sensors(delay=3), rng)
    breaks = np.cumsum(rng.random(len(whole)) < 0.01)
    log = dataclasses.replace(whole, step=(whole.step + breaks).astype(np.uint32))
    # Three periods, and the filter of the sensors.
    assert find_delays([log], None).force == pytest.approx(0.136, abs=0.01)


def test_a_delay_whose_loss_has_a_sharp_minimum_is_found() -> None:
    def losses(of: Sequence[float]) -> delays._Losses:
        values = [math.sqrt(abs(delay - 0.06)) for delay in of]
        return delays._Losses(values, errors=1000)  # noqa: SLF001

    # The loss is no parabola about 0.04 s, which is the best of the coarse steps.
    assert delays._optimum(losses, -1.5) == pytest.approx(0.06)  # noqa: SLF001


def test_inputs_that_both_ends_of_a_range_have_are_there_for_all_delays_between() -> None:
    log = rough_at_the_ends(0, runs=2, periods=100)
    ends = Delays(0.0, -0.6), Delays(0.1, 0.3)
    kept = available(log, ends[0]) & available(log, ends[1])
    # 0.3 s are 8 of the first periods, and 0.6 s 15 of the last.
    assert log.step[kept].tolist() == 2 * list(range(8, 85))
    for moved_by in (*ends, Delays(), Delays(0.05, 0.12)):
        moved = align(log, moved_by, kept)
        np.testing.assert_array_equal(moved.y, log.y[kept])
        of_all = align(log, moved_by)
        np.testing.assert_array_equal(moved.z, of_all.z[np.isin(of_all.y[:, 0], log.y[kept][:, 0])])
