"""Noise of the window's errors, for contenders that weigh them outside the service."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from egp_service._core import Member

# Fractions of the members' noise and of the measured states' noise, as the service considers them.
LEAST_MODEL_NOISE: Final = 0.5
_LEVELS: Final = tuple((q, r) for r in (1.0, 0.3, 0.1) for q in (1.0, LEAST_MODEL_NOISE))


def model_noise(members: Sequence[Member]) -> NDArray[np.float64]:
    """Find the members' root-mean-square noise, (3,), in m/s, m/s and rad/s a period."""
    mean: NDArray[np.float64] = np.mean([member.noise_std**2 for member in members], axis=0)
    return np.sqrt(mean)


def covariance(
    model: NDArray[np.float64], state: NDArray[np.float64], size: int
) -> NDArray[np.float64]:
    """Make the (3, size, size) covariance of consecutive errors from standard deviations (3,).

    `q + 2 r` on the diagonal and `-r` beside it, q and r the squares of `model` and `state`.
    """
    q, r = model**2, state**2
    neighbours = np.eye(size, k=1) + np.eye(size, k=-1)
    return np.multiply.outer(q + 2.0 * r, np.eye(size)) - np.multiply.outer(r, neighbours)


class WindowNoise:
    """Covariances of K consecutive errors, of which a window takes the likeliest.

    As the service does by the same settings (its `WindowNoise`, where the sources are): from the
    members' noise and that of the measured states, or fractions of these, one for all outputs.
    """

    def __init__(self, members: Sequence[Member], settings: Mapping[str, Any]) -> None:
        """Of the library's `members` and the step's whole `settings`."""
        weights = settings["weights"]
        self.window: int = weights["window"]
        model = model_noise(members)
        state = np.asarray(weights["measurement"], dtype=np.float64)
        self.levels = (
            tuple((q * model, r * state) for q, r in _LEVELS)
            if weights["whiten"]
            else ((np.ones(3), np.zeros(3)),)
        )
        """Standard deviations of model and states, (3,) each; the largest of all first."""
        cholesky = np.linalg.cholesky([covariance(*std, self.window) for std in self.levels])
        self._whitening = np.linalg.inv(cholesky)
        diagonal = np.diagonal(cholesky, axis1=2, axis2=3)
        self._log_determinants = 2.0 * np.cumsum(np.log(diagonal).sum(axis=1), axis=1)

    def whitening(self, level: int, count: int) -> NDArray[np.float64]:
        """Give (3, count, count) lower triangular S: `S[o] @ e[:, o]` of errors e is white."""
        return self._whitening[level, :, :count, :count]

    def likeliest(self, errors: NDArray[np.float64]) -> int:
        """Find the level with the largest Gaussian likelihood for (k, 3) `errors`, k at least 1."""
        count = len(errors)
        white = np.einsum("lokj,jo->lko", self._whitening[:, :, :count, :count], errors)
        return int(np.argmin(np.sum(white**2, axis=(1, 2)) + self._log_determinants[:, count - 1]))
