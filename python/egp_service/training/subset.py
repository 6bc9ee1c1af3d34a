"""Selection of a member's transitions if there are more than `max_points`.

Half of them are drawn uniformly and represent the usual states of vehicles. The other half are
drawn one after the other by randomly pivoted Cholesky (Chen, Epperly, Tropp and Webber, 2022), with
probability proportional to the variance that remains given the points drawn so far. Choosing the
largest variance instead would select mostly outliers. RMS errors of v_y after 1 s with all, half
and none drawn uniformly, on the demo's surfaces with GPs of whole changes: slides after a friction
drop 0.73, 0.61, 0.45 m/s, driving below the limit 0.02-0.07, 0.02, 0.03 m/s.

Points are drawn in blocks with rejection (accelerated RPCholesky: Epperly, Tropp and Webber,
"Embrace rejection", 2024). A block is proposed with the variances before it, and each of its points
is accepted with the probability by which the points accepted before it in the block have reduced
its variance. The distribution of the points is the same as without blocks.

A transition whose measured state is a spike of the sensor lies far from all others, so that its
variance remains large: of 5 % such transitions, spikes of three standard deviations were 20 % of
the second half. They are therefore left out of it (`spikes`).
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
import torch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset
    from egp_service.training.gaussian_process import OutputProcess

_BLOCK = 64
# Changes into a spike and out of it have opposite signs, and both exceed so many times the median
# absolute change.
_SPIKE = 8.0


class _Remaining:
    """The variance that remains of outputs that share a kernel, given noisy observations so far.

    With points P so far and noise variance s, `factor` is F = K(z, P) L⁻ᵀ, where L is the Cholesky
    factor of K(P, P) + s I, so that the covariance that remains is K - F Fᵀ.
    """

    def __init__(self, process: OutputProcess, outputs: int, z: torch.Tensor, count: int) -> None:
        self.kernel, self.outputs, self.z = process.covar_module, outputs, z
        self.noise = float(process.likelihood.noise[0])
        self.size = 0
        self.factor = z.new_zeros(len(z), count)
        self.variance = self.kernel(z, diag=True)

    def covariance(self, of: slice | NDArray[np.int64], rows: NDArray[np.int64]) -> torch.Tensor:
        """Return the covariance that remains between two sets of rows, as a matrix."""
        known = self.factor[:, : self.size]
        prior = self.kernel(self.z[of], self.z[rows]).to_dense()
        remaining: torch.Tensor = prior - known[of] @ known[rows].T
        return remaining

    def observe(self, rows: NDArray[np.int64]) -> None:
        """Add these rows to the points."""
        column = self.covariance(slice(None), rows)
        inner = column[rows] + self.noise * torch.eye(len(rows)).to(column)
        lower = torch.linalg.cholesky(inner)
        added = torch.linalg.solve_triangular(lower, column.T, upper=False).T
        self.factor[:, self.size : self.size + len(rows)] = added
        self.size += len(rows)
        self.variance -= (added**2).sum(dim=1)


def select(
    z: torch.Tensor,
    processes: Sequence[OutputProcess],
    count: int,
    rng: np.random.Generator,
    left_out: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """Choose `count` rows of the z-scored inputs `z` (n, 6); return them in ascending order.

    The outputs share their inputs, so the remaining variances given noisy observations are summed
    over all `processes`; those that share a kernel and its noise have the same variances, which are
    computed once. Targets are z-scored, so the sum is the expected squared error in standard
    deviations. Rows of `left_out` (n,) are drawn uniformly only, which they also are if too few
    others are left.
    """
    n = len(z)
    if n <= count:
        return np.arange(n)
    chosen = rng.choice(n, count // 2, replace=False)
    sharing = Counter(process.covar_module for process in processes)
    kinds = {process.covar_module: process for process in processes}
    with torch.no_grad():
        groups = [
            _Remaining(kinds[kernel], outputs, z, count) for kernel, outputs in sharing.items()
        ]
        for k in range(0, len(chosen), _BLOCK):
            for group in groups:
                group.observe(chosen[k : k + _BLOCK])
        while len(chosen) < count:
            expected = sum(group.outputs * group.variance for group in groups)
            weight = expected.numpy().clip(0.0)
            weight[chosen] = 0.0
            if left_out is not None:
                weight[left_out] = 0.0
            if not weight.any():
                rest = np.setdiff1d(np.arange(n), chosen)
                added = rng.choice(rest, count - len(chosen), replace=False)
                chosen = np.concatenate([chosen, added])
                break
            proposed = rng.choice(n, _BLOCK, p=weight / weight.sum())
            accepted = _accepted(proposed, weight, groups, rng)[: count - len(chosen)]
            for group in groups:
                group.observe(accepted)
            chosen = np.concatenate([chosen, accepted])
    return np.sort(chosen)


def spikes(data: Dataset) -> NDArray[np.bool_]:
    """Return whether each transition (n,) starts at a spike of a measured state.

    A spike is a jump that the next change takes back, as outliers of a sensor make.
    """
    scale = _SPIKE * np.median(np.abs(data.y), axis=0)
    into, out_of = data.y[:-1], data.y[1:]
    there = (into * out_of < 0.0) & (np.minimum(np.abs(into), np.abs(out_of)) > scale)
    return np.concatenate([[False], data.follows & there.any(axis=1)])


def _accepted(
    proposed: NDArray[np.int64],
    weight: NDArray[np.float64],
    groups: Sequence[_Remaining],
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Accept each row with the ratio of its variance, given those accepted, to its `weight`."""
    inner = np.stack([group.covariance(proposed, proposed).numpy() for group in groups])
    noise = np.array([group.noise for group in groups])
    outputs = np.array([group.outputs for group in groups])
    accepted: list[int] = []
    for i, row in enumerate(proposed.tolist()):
        remaining = inner[:, i, i]
        if row in accepted or rng.random() * weight[row] >= outputs @ remaining:
            continue
        accepted.append(row)
        column = inner[:, :, i] / np.sqrt(remaining + noise)[:, None]
        inner -= column[:, :, None] * column[:, None, :]
    return np.array(accepted, dtype=np.int64)
