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
