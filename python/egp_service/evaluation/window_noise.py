"""Noise of the window's errors, for contenders that weigh them outside the service."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from egp_service._core import Member


def whitening(members: Sequence[Member], settings: Mapping[str, Any]) -> NDArray[np.float64]:
    """Make (3, K, K) lower triangular S: `S[o] @ e[:, o]` of K consecutive errors is white noise.

    As the service does by the same whitening settings: SᵀS is the inverse of a covariance with
    `q + 2 r` on the diagonal and `-r` beside it, from the members' noise variance q and that of the
    measured states r. For fewer errors take the leading block.
    """
    weights = settings["weights"]
    size = weights["window"]
    if not weights["whiten"]:
        return np.tile(np.eye(size), (3, 1, 1))
    q = np.mean([member.noise_std**2 for member in members], axis=0)
    r = np.square(weights["measurement"])
    neighbours = np.eye(size, k=1) + np.eye(size, k=-1)
    covariance = np.multiply.outer(q + 2.0 * r, np.eye(size)) - np.multiply.outer(r, neighbours)
    return np.linalg.inv(np.linalg.cholesky(covariance))
