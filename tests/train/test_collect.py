"""Collecting on the plant: reproducible, consistent in time, and wide enough."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from egp_service import EgpError
from egp_service._core import GRAVITY, Plant
from egp_service.data.collect import CollectionSettings, collect
from egp_service.data.experiment import Experiment
from egp_service.data.exploration import ExplorationSettings, explore
from egp_service.data.exploration_track import ExplorationTrack
from egp_service.data.sampling import sample
from egp_service.data.steady import steady

if TYPE_CHECKING:
    from egp_service.data.dataset import Dataset

WET = Experiment(friction=0.5, label="wet", seed=3)
SHORT = CollectionSettings(
    runs=2, samples=20, steady=10, exploration=ExplorationSettings(episodes=4)
)


@pytest.fixture(scope="module")
def run() -> Dataset:
    """One run with arrivals only, so that sliding is in it."""
    settings = ExplorationSettings(episodes=8, arrivals=1.0, grip=(0.5, 1.0))
    return explore(WET, ExplorationTrack("rounded-rectangle", WET.parameters), settings)


def test_same_seed_same_data_in_any_number_of_processes() -> None:
    alone, together = collect(WET, SHORT, jobs=1), collect(WET, SHORT, jobs=2)
    assert alone.digest() == together.digest()
    other = collect(Experiment(friction=0.5, label="wet", seed=4), SHORT, jobs=1)
    assert alone.digest() != other.digest()


def test_a_preset_is_labelled_by_its_peak() -> None:
    snow = collect(Experiment(friction="snow", label="snow", seed=3), SHORT, jobs=1)
    assert snow.provenance.friction == 0.3
    method = "random sampling on snow + steady inputs on snow + track on snow"
    assert snow.provenance.method == method
    number = collect(Experiment(friction=0.3, label="snow", seed=3), SHORT, jobs=1)
    assert snow.digest() != number.digest()
    with pytest.raises(EgpError, match="no surface"):
        collect(Experiment(friction="mud", label="mud"), SHORT, jobs=1)


def test_progress_counts_runs() -> None:
    seen: list[tuple[int, int]] = []
    collect(WET, SHORT, jobs=1, report=lambda done, total: seen.append((done, total)))
    assert seen == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]


def test_rows_follow_each_other_in_time(run: Dataset) -> None:
    same = run.trajectory[1:] == run.trajectory[:-1]
    np.testing.assert_array_equal(run.step[1:][same], run.step[:-1][same] + 1)
    end = run.z[:-1, :3] + run.y[:-1]
    np.testing.assert_allclose(end[same], run.z[1:, :3][same], atol=1e-12)
    steered = run.z[:-1, 3] + 0.02 * run.z[:-1, 5]
    np.testing.assert_allclose(steered[same], run.z[1:, 3][same], atol=1e-9)


def test_inputs_stay_within_the_controllers_limits(run: Dataset) -> None:
    a, delta_dot = run.z[:, 4] / WET.mass, run.z[:, 5]
    assert a.min() >= WET.parameters.a_min
    assert np.all(a * run.z[:, 0] <= 54.7 + 1e-9)
    assert np.abs(delta_dot).max() <= WET.parameters.steering_rate
    same = run.trajectory[1:] == run.trajectory[:-1]
    assert np.abs(np.diff(delta_dot))[same].max() <= WET.parameters.steering_slew * WET.dt + 1e-9
    # The engine's limit shrinks with speed, which may take more than a step of slew.
    free = same & (a[1:] * run.z[1:, 0] < 54.0)
    assert np.abs(np.diff(a))[free].max() <= WET.parameters.a_slew * WET.dt + 1e-9


def test_arrivals_are_faster_than_the_surface_allows(run: Dataset) -> None:
    track = ExplorationTrack("rounded-rectangle", WET.parameters)
    own = max(track.start(s, 0.5, 1.0)[2] for s in np.linspace(0.0, track.length, 200))
    assert run.z[:, 0].max() > own
    lateral = np.abs(run.z[:, 0] * run.z[:, 2])
    assert lateral.max() > 0.95 * 0.5 * 9.81


def test_transitions_are_the_plants() -> None:
    """The dataset against the single plant, driven by hand."""
    one = sample(WET, 1, settle=0, keep=2)
    plant = Plant(1)
    v_x, v_y, omega, delta = one.z[0, :4]
    plant.reset(0.0, 0.0, 0.0, v_x, yaw_rate=omega, v_y=v_y, delta=delta)
    for k in range(2):
        before = plant.vehicle_state
        plant.step(one.z[k, 4:], 0.02, 0.5)
        change = (plant.vehicle_state - before)[[2, 4, 5]]
        np.testing.assert_allclose(one.y[k], change, atol=1e-12)


def test_samples_fill_their_bounds() -> None:
    many = sample(WET, 300)
    assert many.provenance.method == "random sampling"
    assert many.provenance.vehicle == "commonroad-1"
    assert many.z[:, 0].min() < 4.0
    assert many.z[:, 0].max() > 24.0
    assert np.abs(many.z[:, 1] / many.z[:, 0]).max() > 0.1
    assert np.ptp(many.z[:, 5]) > 1.5 * WET.parameters.steering_rate


def test_steady_inputs_are_constant_and_cover_the_speeds() -> None:
    data = steady(WET, 200, 27.0)
    assert data.provenance.method == "steady inputs"
    each = data.z.reshape(-1, 25, 6)
    assert len(each) > 150  # the others slide
    assert np.all(np.abs(data.z[:, 1]) < 0.2 * data.z[:, 0] + 0.05)
    assert np.all(each[:, :, 4:] == each[:, :1, 4:])
    assert np.all(each[:, :, 5] == 0.0)
    a, speeds = each[:, 0, 4] / WET.mass, each[:, 0, 0]
    assert a.min() < -0.8 * WET.mu * GRAVITY
    assert a.max() > 0.8 * WET.mu * GRAVITY
    assert a.max() <= WET.mu * GRAVITY
    assert speeds.min() < 2.0
    assert speeds.max() > 25.0
    gentle = np.abs(a) <= 1.0
    assert 0.4 < gentle.mean() < 0.8
    # The suspension has settled, so that yaw rate and lateral speed hardly change.
    change = data.y.reshape(-1, 25, 3)[gentle][:, :, 1:] / WET.dt
    assert np.median(np.abs(change)) < 0.02
    lateral = speeds * each[:, 0, 2] / (WET.mu * GRAVITY)
    assert lateral.min() < -0.4
    assert lateral.max() > 0.4
    slow = speeds < WET.parameters.slip_speed
    assert slow.sum() > 10
    assert np.all(each[slow][:, :, 3] == 0.0)


def test_steady_inputs_may_be_those_of_slow_cars_alone() -> None:
    assert steady(WET, 20, 0.5).z[:, 0].min() > 0.5


def test_both_directions_turn() -> None:
    left, right = (
        explore(
            WET,
            ExplorationTrack("rounded-rectangle", WET.parameters, reverse=reverse),
            SHORT.exploration,
        )
        for reverse in (False, True)
    )
    assert left.z[:, 2].mean() > 0.05
    assert right.z[:, 2].mean() < -0.05


def test_refuses_what_is_not_there() -> None:
    with pytest.raises(EgpError, match="no track 'moon'"):
        collect(WET, CollectionSettings(tracks=("moon",), runs=1), jobs=1)
    with pytest.raises(EgpError, match="samples is -5: expected a number of at least 0"):
        CollectionSettings(runs=1, samples=-5)
    with pytest.raises(EgpError, match="nothing to collect"):
        CollectionSettings(runs=0, samples=0, steady=0)


def test_the_largest_seed_is_one_of_every_run() -> None:
    short = ExplorationSettings(episodes=1, seconds=0.1, warm_up=0.0)
    settings = CollectionSettings(
        runs=1, samples=0, steady=0, tracks=("random",), exploration=short
    )
    for seed in (20261129150300, 2**63 - 1):
        assert len(collect(Experiment(friction=0.8, label="a", seed=seed), settings, jobs=1)) > 0


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"vehicle": 9}, "one of the CommonRoad vehicles"),
        ({"vehicle": [1]}, r"vehicle \[1\] .*: expected a coefficient"),
        ({"seed": 2**63}, r"seed is 9223372036854775808: expected a whole number from 0 to 2\^63"),
        ({"vehicle": 10**30}, "whole numbers as seed and vehicle"),
        ({"friction": [0.5]}, r"friction \[0.5\], .*: expected a coefficient"),
        ({"friction": "mud"}, "no surface"),
        ({"friction": 0.0}, "expected a friction coefficient"),
        ({"friction": 3.5}, "expected a friction coefficient > 0 and at most 3"),
        ({"dt": 0.0}, "dt is 0.0 s: expected a period"),
        ({"dt": "0.02"}, "a period in s"),
        ({"label": ""}, "the surface label is empty"),
        ({"label": ["wet"]}, r"surface is \['wet'\]: expected a text"),
    ],
)
def test_an_experiment_is_checked_when_it_is_made(
    changes: dict[str, object], complaint: str
) -> None:
    with pytest.raises(EgpError, match=complaint):
        Experiment(**({"friction": 0.5, "label": "wet"} | changes))  # type: ignore[arg-type]
