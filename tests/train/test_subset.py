"""Subset selection: deterministic, spread out, and better than chance where data are rare."""

from __future__ import annotations

import numpy as np
import torch

from egp_service.data.collect import CollectionSettings, collect
from egp_service.data.dataset import Dataset
from egp_service.data.experiment import Experiment
from egp_service.data.exploration import ExplorationSettings
from egp_service.data.provenance import Provenance
from egp_service.training.exact_member import exact_member
from egp_service.training.gaussian_process import (
    WHOLE_CHANGES,
    Hyperparameters,
    OutputProcess,
    share_kernel,
)
from egp_service.training.subset import select, spikes
from egp_service.training.train import TrainingSettings


def _processes(z: torch.Tensor) -> list[OutputProcess]:
    processes = []
    for lengthscale in (1.0, 2.0):
        process = OutputProcess(z[:10], z[:10, 0].contiguous(), "rbf", WHOLE_CHANGES)
        process.assign(Hyperparameters((lengthscale,) * 6, 1.0, 1e-3, 0.0))
        processes.append(process)
    return processes


def _clustered() -> torch.Tensor:
    """Return 500 nearly equal states, then 20 different ones."""
    rng = np.random.default_rng(0)
    common = 0.02 * rng.standard_normal((500, 6))
    rare = 3.0 * rng.standard_normal((20, 6))
    return torch.tensor(np.vstack([common, rare]))


def test_finds_the_rare_and_keeps_the_common() -> None:
    z = _clustered()
    chosen = select(z, _processes(z), 60, np.random.default_rng(1))
    assert len(set(chosen.tolist())) == 60
    assert np.all(np.diff(chosen) > 0)
    assert np.sum(chosen >= 500) == 20
    assert np.sum(chosen < 500) == 40


def _one_by_one(K: np.ndarray, noise: float, count: int, rng: np.random.Generator) -> list[int]:
    """Draw rows as `select` promises, each with the variance of the exact posterior."""
    chosen: list[int] = rng.choice(len(K), count // 2, replace=False).tolist()
    while len(chosen) < count:
        inner = K[np.ix_(chosen, chosen)] + noise * np.eye(len(chosen))
        left = np.diag(K) - np.sum(K[chosen] * np.linalg.solve(inner, K[chosen]), axis=0)
        left[chosen] = 0.0
        chosen.append(rng.choice(len(K), p=left / left.sum()))
    return chosen


def _places() -> torch.Tensor:
    """Return three places with six states each and six places with one."""
    rng = np.random.default_rng(0)
    centres = 3.0 * rng.standard_normal((9, 6))
    states = np.repeat(centres, [6, 6, 6, 1, 1, 1, 1, 1, 1], axis=0)
    return torch.tensor(states + 0.02 * rng.standard_normal(states.shape))


def test_blocks_do_not_change_the_probabilities() -> None:
    z = _places()
    process = _processes(z)[1]
    with torch.no_grad():
        K = process.covar_module(z).to_dense().numpy()
    noise = float(process.likelihood.noise.detach()[0])
    ours, expected = np.zeros(len(z)), np.zeros(len(z))
    draws = 2000
    for seed in range(draws):
        ours[select(z, [process], 6, np.random.default_rng(seed))] += 1 / draws
        expected[_one_by_one(K, noise, 6, np.random.default_rng(draws + seed))] += 1 / draws
    # Five standard deviations of a difference of two frequencies.
    assert np.all(np.abs(ours - expected) < 5.0 * np.sqrt(2.0 * 0.25 / draws))


def test_outputs_that_share_a_kernel_count_as_often_as_they_are() -> None:
    z = _clustered()
    narrow, wide = _processes(z)
    separate = [narrow, *(_processes(z)[1] for _ in range(2))]
    share_kernel(shared := [wide, *(_processes(z)[1] for _ in range(1))])
    rows = [
        select(z, processes, 60, np.random.default_rng(1)).tolist()
        for processes in (separate, [narrow, *shared])
    ]
    assert rows[0] == rows[1]


def test_follows_its_seed() -> None:
    z = _clustered()
    first, second, other = (
        select(z, _processes(z), 30, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    assert first.tolist() == second.tolist()
    assert first.tolist() != other.tolist()


def test_keeps_all_of_little() -> None:
    z = _clustered()[:15]
    assert select(z, _processes(z), 15, np.random.default_rng(0)).tolist() == list(range(15))


def _measured(size: float) -> tuple[Dataset, np.ndarray]:
    """Four drives of 40 s in which 5 % of the measured v_y are off by `size` m/s, and which."""
    rng = np.random.default_rng(0)
    time = 0.04 * np.arange(1001)
    states, known = [], []
    for _ in range(4):
        waves = [
            [np.sin(2.0 * np.pi * (f * (1.0 + 0.1 * j) * time + rng.random())) for j in range(6)]
            for f in (0.05, 0.13, 0.31)
        ]
        state = np.sum(waves, axis=0).T
        outlying = np.append(rng.random(1000) < 0.05, False)
        state[:, 1] += size * outlying * rng.choice([-1.0, 1.0], 1001)
        states.append(state)
        known.append(outlying[:-1])
    data = Dataset(
        z=np.concatenate([state[:-1] for state in states]),
        y=np.concatenate([np.diff(state[:, :3], axis=0) for state in states]),
        trajectory=np.repeat(np.arange(4, dtype=np.uint32), 1000),
        step=np.tile(np.arange(1000, dtype=np.uint32), 4),
        provenance=Provenance(0.04, "toy", "dry", 1.0, 0, "formula", "test"),
    )
    return data, np.concatenate(known)


def test_does_not_collect_the_noisiest() -> None:
    data, noisy = _measured(4.0)
    z = torch.tensor((data.z - data.z.mean(axis=0)) / data.z.std(axis=0))
    process = _processes(z)[1]
    found = spikes(data)
    # Two spikes in a row are not told from one motion.
    assert np.mean(found[noisy]) > 0.85
    assert not np.any(found[~noisy & ~np.roll(noisy, -1) & ~np.roll(noisy, 1)])
    plain, careful = (
        select(z, [process], 400, np.random.default_rng(1), left_out) for left_out in (None, found)
    )
    assert noisy[plain].mean() > 1.5 * noisy.mean()
    assert noisy[careful].mean() < noisy.mean()
    # A member is trained on this choice.
    settings = TrainingSettings(max_points=400, first_points=50, max_iterations=3, restarts=0)
    member = exact_member((data, data), settings, np.random.default_rng(1), lambda *_: None)
    kept = (member.inputs[:, None, 1] == data.z[noisy, 1]).any(axis=1)
    assert kept.mean() < noisy.mean()


def test_spikes_are_chosen_where_too_few_others_are_left() -> None:
    z = torch.tensor(np.random.default_rng(0).standard_normal((65, 6)))
    spiky = np.arange(65) % 6 == 0
    chosen = select(z, _processes(z), 62, np.random.default_rng(1), spiky)
    assert len(set(chosen.tolist())) == 62
    assert not np.any(np.isin(np.flatnonzero(~spiky), chosen, invert=True))


def test_motion_of_the_simulated_car_is_no_spike() -> None:
    settings = CollectionSettings(
        runs=2, samples=50, steady=0, exploration=ExplorationSettings(episodes=5)
    )
    for friction in (0.5, 1.1):
        data = collect(Experiment(friction, "road", 1, 0.02, 1), settings, jobs=1)
        assert not spikes(data).any()
