"""Members of logs on the logs of other roads: their errors, and their weights over time."""

from __future__ import annotations

import dataclasses
import warnings
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.figure import Figure

from egp_service.data.alignment import Delays
from egp_service.data.collect import CollectionSettings, collect
from egp_service.data.dataset import Dataset
from egp_service.data.experiment import Experiment
from egp_service.data.provenance import Provenance
from egp_service.data.sensors import Sensors, measure
from egp_service.evaluation import logs
from egp_service.evaluation.log_figures import draw_log
from egp_service.evaluation.logs import OTHER, OURS, LogOutcome, _last_change, evaluate_logs
from egp_service.training.open_loop import NO_CHANGE, skill
from egp_service.training.train import TrainingSettings
from egp_service.vehicle import known_vehicle

if TYPE_CHECKING:
    from pathlib import Path

DT = 0.04  # 25 Hz
SETTINGS = TrainingSettings(max_points=60, first_points=60, restarts=0, max_iterations=5)


def log(name: str, friction: float, track: str, seed: int) -> Dataset:
    """Return a drive on one track as the sensors of a real car measure it, in blocks of 4 s."""
    settings = CollectionSettings(tracks=(track,), runs=1, samples=0, steady=0)
    found = collect(Experiment(friction, name, seed, DT, 1), settings, jobs=1)
    block = np.cumsum(
        np.concatenate([[0], np.diff(found.trajectory) != 0]) | (found.step % 100 == 0)
    )
    found = dataclasses.replace(found, trajectory=block.astype(np.uint32))
    return measure(found, Sensors(), np.random.default_rng(seed))


@pytest.fixture(scope="module")
def outcomes() -> dict[str, LogOutcome]:
    """Of three frictions, and of two tracks of the same friction."""
    drives = [
        log("ice", 0.4, "rounded-rectangle", 1),
        log("wet", 0.7, "rounded-rectangle", 2),
        log("dry", 1.1, "rounded-rectangle", 3),
        log("dry elsewhere", 1.1, "random", 4),
    ]
    found = evaluate_logs(drives, known_vehicle("commonroad-1"), SETTINGS)
    return {outcome.name: outcome for outcome in found}


def test_a_log_without_a_duration_to_compare_is_drawn(
    outcomes: dict[str, LogOutcome], tmp_path: Path
) -> None:
    outcome = outcomes["wet"]
    slow = dataclasses.replace(
        outcome.member.validation, z=outcome.member.validation.z * [0.1, 1, 1, 1, 1, 1]
    )
    member = dataclasses.replace(outcome.member, validation=slow)
    compared = skill({OURS: member.predict_mean}, slow)
    assert compared.durations == ()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(_last_change(outcome.member.dataset, slow, (1.0, 1.0))).all()
    draw_log(dataclasses.replace(outcome, member=member, skill=compared), tmp_path / "wet.png")
    assert (tmp_path / "wet.png").exists()


@pytest.mark.parametrize(
    ("name", "other", "duration"),
    [
        ("dry", "dry elsewhere", DT),
        ("dry elsewhere", "dry", DT),
        ("dry", "dry elsewhere", 1.0),
        ("dry elsewhere", "dry", 1.0),
    ],
)
def test_members_of_each_track_predict_the_other_no_worse_than_no_change(
    outcomes: dict[str, LogOutcome], name: str, other: str, duration: float
) -> None:
    found = outcomes[name].skill
    row = found.durations.index(duration)
    # Measured at most 0.69 over one period and 0.83 after 1 s.
    assert np.all(found.rms[OTHER.format(other)][row] <= found.rms[NO_CHANGE][row])


@pytest.mark.parametrize(
    ("name", "nearest"), [("ice", "wet"), ("dry", "dry elsewhere"), ("dry elsewhere", "dry")]
)
def test_weights_over_time_are_those_of_the_nearest_friction(
    outcomes: dict[str, LogOutcome], name: str, nearest: str
) -> None:
    outcome = outcomes[name]
    assert outcome.weights is not None
    assert outcome.weights.shape == (len(outcome.member.validation), 3)
    known = np.asarray(np.isfinite(outcome.weights).all(axis=1))
    weights = outcome.weights[known]
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-6)
    assert weights.min() > -1e-9
    # The first 0.5 s of each block of 4 s have no full window.
    held = outcome.member.validation
    starts = np.flatnonzero(np.diff(held.trajectory, prepend=held.trajectory[0] + 1))
    for start in starts:
        assert not known[start : start + 12].any()
    assert np.mean(known) > 0.8
    # Measured 0.97, 0.85 and 0.94.
    mean = weights.mean(axis=0)
    assert mean[outcome.others.index(nearest)] > 0.6


def test_weights_do_not_come_from_a_window_across_a_gap(outcomes: dict[str, LogOutcome]) -> None:
    held = outcomes["ice"].member.validation
    members = [outcomes[name].member for name in ("wet", "dry")]
    after = int(np.flatnonzero(held.follows)[50]) + 1
    late = (np.arange(len(held)) >= after) & (held.trajectory == held.trajectory[after])
    broken = dataclasses.replace(held, step=held.step + late.astype(np.uint32))
    whole, found = (logs._weights(data, members) for data in (held, broken))  # noqa: SLF001
    window = slice(after, after + 12)  # 0.5 s
    assert np.isfinite(whole[window]).all()
    assert np.isnan(found[window]).all()
    np.testing.assert_array_equal(found[:after], whole[:after])
    assert np.isfinite(found[after + 12]).all()


def test_held_out_blocks_have_no_part_in_the_search_for_delays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The third of ten blocks is shorter than the delay, so that it is lost.
    lengths = [60, 60, 2, 60, 60, 60, 60, 60, 60, 60]
    rng, n = np.random.default_rng(0), sum(lengths)
    data = Dataset(
        z=np.array([15.0, 0.0, 0.0, 0.0, 0.0, 0.0]) + 0.1 * rng.standard_normal((n, 6)),
        y=0.1 * rng.standard_normal((n, 3)),
        trajectory=np.repeat(np.arange(len(lengths), dtype=np.uint32), lengths),
        step=np.concatenate([np.arange(length, dtype=np.uint32) for length in lengths]),
        provenance=Provenance(DT, "own car", "dry", 1.0, 0, "log", "test"),
    )
    searched: list[set[int]] = []
    trained: list[list[set[int]]] = []

    def blocks(part: Dataset) -> set[int]:
        return set(np.unique(part.trajectory).tolist())

    def found(parts: list[Dataset], _: object) -> Delays:
        searched.extend(map(blocks, parts))
        return Delays(measurement=3 * DT)

    def keep(parts: list[tuple[Dataset, Dataset]], *_: object) -> None:
        trained.extend(list(map(blocks, part)) for part in parts)
        raise InterruptedError

    monkeypatch.setattr(logs, "find_delays", found)
    monkeypatch.setattr(logs, "_train", keep)
    with pytest.raises(InterruptedError):
        evaluate_logs([data], None, SETTINGS)
    assert searched == [{0, 1, 2, 3, 5, 6, 7, 8}]
    assert trained == [[{0, 1, 3, 5, 6, 7, 8}, {4, 9}]]


def test_the_picture_names_the_members_whose_weights_it_shows(
    outcomes: dict[str, LogOutcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Figure] = []
    picture = tmp_path / "wet.png"

    def keep(figure: Figure, path: Path, **_: object) -> None:
        drawn.append(figure)
        assert path != picture, "an interruption would leave half of a picture"
        path.touch()

    monkeypatch.setattr(Figure, "savefig", keep)
    draw_log(outcomes["wet"], picture)
    assert picture.exists()
    axes = drawn[0].axes[-1]
    assert axes.get_title() == "weights of other members"
    legend = axes.get_legend()
    assert legend is not None
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == [OTHER.format(name) for name in ("ice", "dry", "dry elsewhere")]
    lines = axes.get_lines()
    weights = outcomes["wet"].weights
    assert weights is not None
    for line, weight in zip(lines, weights.T, strict=True):
        np.testing.assert_array_equal(line.get_ydata(), weight)
