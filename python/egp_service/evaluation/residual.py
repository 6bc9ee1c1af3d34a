"""The residual of the control step on a log: which settings predict a member's errors best."""

from __future__ import annotations

import dataclasses
import itertools
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import predict_residual
from egp_service.data.alignment import consecutive
from egp_service.quantities import NY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset
    from egp_service.training.open_loop import Predictor

WINDOW: Final = 0.5
"""Duration in s of the errors from which the residual is estimated, that of the default window."""
_TIMES: Final = (0.02, 0.1, 0.3, 1.0, 3.0, 10.0)  # s
_RATIOS: Final = (0.0, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.2, 2.0)  # of disturbance and noise
_SHARES: Final = (0.0, 0.1, 0.2, 0.3, 0.4)  # of the measured states' noise in the errors
# Nats per error by which a residual must predict better than none.
_GAIN: Final = 0.002


@dataclasses.dataclass(frozen=True, eq=False)
class Residual:
    """Settings of `[residual]`, for changes over one period.

    All arrays are (3,), for v_x, v_y (m/s) and omega (rad/s).
    """

    std: NDArray[np.float64]
    """Standard deviations of the slow disturbance; zero where it does not pay."""
    time: NDArray[np.float64]
    """Correlation times of the disturbance in s."""
    noise: NDArray[np.float64]
    """Standard deviations of errors that are independent between periods."""
    measurement: NDArray[np.float64]
    """Standard deviations of the noise of the measured states; zero where it does not pay."""

    def settings(self) -> str:
        """Return the table `[residual]` of the control step's settings, in TOML."""
        rows = dataclasses.asdict(self).items()
        lines = [f"{key} = [{', '.join(f'{v:.3g}' for v in row)}]" for key, row in rows]
        return "\n".join(["[residual]", *lines])

    def predict(
        self, errors: NDArray[np.float64], dt: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Predict each of consecutive errors (n, 3) from those before; mean and variance (n, 3)."""
        window = max(1, round(WINDOW / dt))
        return predict_residual(errors, dt=dt, window=window, **dataclasses.asdict(self))


def moving_runs(data: Dataset) -> tuple[Dataset, list[NDArray[np.intp]]]:
    """Return the transitions that count and the rows of each run of consecutive ones."""
    moving = data.select(data.counts)
    return moving, [rows for rows in consecutive(moving) if len(rows) > 1]


def fit_residual(predict: Predictor, training: Dataset) -> Residual:
    """Choose the residual of largest likelihood for the errors of `predict` on training data.

    The likelihood is that of the normal distribution, so that the RMS of what the residual leaves
    decides: with Student's distribution the limit of the innovations cut real motion. Correlation
    times from 0.02 to 10 s, ratios of disturbance and noise up to 2, and shares of the measured
    states' noise up to 0.4 of the errors' scale are compared for each output alone.
    """
    moving, runs = moving_runs(training)
    dt = training.provenance.dt
    errors = moving.y - predict(moving.z)
    parts = [errors[rows] for rows in runs]
    if not parts:
        return Residual(np.zeros(NY), np.ones(NY), np.ones(NY), np.zeros(NY))
    total = np.maximum(_rms(parts), 1e-9)
    best = _candidate(total, 0.0, 1.0, 0.0)
    least = np.log(_left(best, parts, dt)) - _GAIN
    for ratio, time, share in itertools.product(_RATIOS, _TIMES, _SHARES):
        candidate = _candidate(total, ratio, time, share)
        found = np.log(_left(candidate, parts, dt))
        better = found < least
        least = np.where(better, found, least)
        best = Residual(
            np.where(better, candidate.std, best.std),
            np.where(better, candidate.time, best.time),
            np.where(better, candidate.noise, best.noise),
            np.where(better, candidate.measurement, best.measurement),
        )
    return best


def _candidate(total: NDArray[np.float64], ratio: float, time: float, share: float) -> Residual:
    """Return a residual whose errors have the scale `total` (3,) altogether."""
    noise = total * np.sqrt((1.0 - 2.0 * share**2) / (1.0 + ratio**2))
    return Residual(ratio * noise, np.full(NY, time), noise, share * total)


def _left(
    residual: Residual, parts: Sequence[NDArray[np.float64]], dt: float
) -> NDArray[np.float64]:
    """RMS (3,) of the errors that the residual leaves."""
    left = [part - residual.predict(part, dt)[0] for part in parts]
    return np.maximum(_rms([part[1:] for part in left]), 1e-12)


def _rms(parts: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)))
