"""Subset selection: deterministic, spread out, and better than chance where data are rare."""

from __future__ import annotations

import numpy as np
import torch

from egp_service.training.gaussian_process import WHOLE_CHANGES, Hyperparameters, OutputProcess
from egp_service.training.subset import select


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
