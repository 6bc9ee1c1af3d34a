"""Covariance of the errors in the window, for contenders that whiten them outside the service."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from egp_service._core import Member

# Candidate fractions of the members' noise and of the states' noise, as in the service.
LEAST_MODEL_NOISE: Final = 0.5
_LEVELS: Final = tuple((q, r) for r in (1.0, 0.3, 0.1) for q in (1.0, LEAST_MODEL_NOISE))


def model_noise(members: Sequence[Member]) -> NDArray[np.float64]:
    """Return the members' root-mean-square noise (3,) in m/s, m/s and rad/s per period."""
    mean: NDArray[np.float64] = np.mean([member.noise_std**2 for member in members], axis=0)
    return np.sqrt(mean)


def covariance(
    model: NDArray[np.float64], state: NDArray[np.float64], size: int
) -> NDArray[np.float64]:
    """Return the (3, size, size) covariance of consecutive errors from standard deviations (3,).

    The diagonal is `q + 2 r` and the off-diagonal `-r`, with q and r the squares of `model` and
    `state`.
    """
    q, r = model**2, state**2
    neighbours = np.eye(size, k=1) + np.eye(size, k=-1)
    return np.multiply.outer(q + 2.0 * r, np.eye(size)) - np.multiply.outer(r, neighbours)


class WindowNoise:
    """Candidate covariances of K consecutive errors; a window uses the one of largest likelihood.

    They follow from the members' noise, the noise of the measured states and fractions of both, one
    level for all outputs, as in the service with the same settings (see `WindowNoise` in Rust,
    which cites the sources).
    """

    def __init__(self, members: Sequence[Member], settings: Mapping[str, Any]) -> None:
        """Compute the covariances for `members` and the complete `settings` of the step."""
        weights = settings["weights"]
        self.window: int = weights["window"]
        model = model_noise(members)
        state = np.asarray(weights["measurement"], dtype=np.float64)
        self.levels = (
            tuple((q * model, r * state) for q, r in _LEVELS)
            if weights["whiten"]
            else ((np.ones(3), np.zeros(3)),)
        )
        """Standard deviations of model and states, (3,) each, the largest first."""
        cholesky = np.linalg.cholesky([covariance(*std, self.window) for std in self.levels])
        self._whitening = np.linalg.inv(cholesky)
        diagonal = np.diagonal(cholesky, axis1=2, axis2=3)
        self._log_determinants = 2.0 * np.cumsum(np.log(diagonal).sum(axis=1), axis=1)

    def whitening(self, level: int, count: int) -> NDArray[np.float64]:
        """Return lower triangular S (3, count, count); `S[o] @ e[:, o]` of errors e is white."""
        return self._whitening[level, :, :count, :count]

    def likeliest(self, errors: NDArray[np.float64]) -> int:
        """Return the level with the largest Gaussian likelihood of `errors` (k, 3), k >= 1."""
        count = len(errors)
        white = np.einsum("lokj,jo->lko", self._whitening[:, :, :count, :count], errors)
        return int(np.argmin(np.sum(white**2, axis=(1, 2)) + self._log_determinants[:, count - 1]))
