"""What the sensors of a log do to its channels: white noise and delays, estimated from the log."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.quantities import GP_INPUT, NY

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset

MAD: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
_ORDER: Final = 4
# Sum of the squared coefficients 1, -4, 6, -4, 1 of the fourth difference.
_GAIN: Final = 70.0
_LONGEST: Final = 1.0  # s
_SAME: Final = 1e-9  # m/s and rad/s; differences between a state and its sum by rounding
V_X, _, OMEGA, DELTA, FORCE, _ = range(len(GP_INPUT))


@dataclasses.dataclass(frozen=True, eq=False)
class Channels:
    """Noise and delays of a log's channels."""

    noise: NDArray[np.float64]
    """Standard deviations (3,) of the white noise of v_x, v_y (m/s) and omega (rad/s)."""
    autocorrelation: NDArray[np.float64]
    """Correlation (3,) of consecutive changes; noise that is larger than the motion gives -0.5."""
    steering_delay: float
    """Time in s by which the yaw rate follows the steering angle times the speed."""
    force_delay: float
    """Time in s by which the change of v_x follows the force; negative if the log's force, or the
    acceleration from which it was made, is a filtered measurement of what has happened."""


def channels(dataset: Dataset) -> Channels:
    """Estimate noise and delays from the transitions that count.

    The noise is what fourth differences of the states leave, which remove cubic motion (Hall, Kay
    and Titterington 1990); noise with a longer correlation than a few periods counts as motion. It
    is NaN unless five consecutive states are those to which the transitions before them lead.
    Delays are the lags of largest correlation, up to 1 s; they are NaN without consecutive
    transitions over twice that time.
    """
    dt = dataset.provenance.dt
    z, y = dataset.z, dataset.y
    pairs = dataset.follows & dataset.counts[1:]
    before, after = y[:-1][pairs], y[1:][pairs]
    correlation = np.array([_correlation(before[:, o], after[:, o]) for o in range(NY)])
    return Channels(
        noise=_noise(dataset),
        autocorrelation=correlation,
        steering_delay=dt * _lag(dataset, z[:, DELTA] * z[:, V_X], z[:, OMEGA]),
        force_delay=dt * _lag(dataset, z[:, FORCE], y[:, V_X]),
    )


def _noise(dataset: Dataset) -> NDArray[np.float64]:
    """Return the standard deviations (3,) of the noise, or NaN if the transitions are too few."""
    unknown = np.full(NY, np.nan)
    if len(dataset) <= _ORDER:
        return unknown
    states, y = dataset.z[:, :NY], dataset.y + dataset.by_gravity
    whole = dataset.unbroken(_ORDER) & dataset.counts[_ORDER:]
    chained = np.all(np.isclose(states[1:], states[:-1] + y[:-1], rtol=0.0, atol=_SAME), axis=1)
    whole &= np.lib.stride_tricks.sliding_window_view(chained, _ORDER).all(axis=1)
    fourth = np.diff(states, n=_ORDER, axis=0)[whole]
    if len(fourth) == 0:
        return unknown
    return np.asarray(MAD * np.median(np.abs(fourth), axis=0) / np.sqrt(_GAIN))


def _correlation(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Correlation of two arrays, whose outliers are moved to their 1 % and 99 % quantiles."""
    if len(a) < 2:  # noqa: PLR2004
        return float("nan")
    a, b = (np.clip(v, *np.quantile(v, [0.01, 0.99])) for v in (a, b))
    spread = a.std() * b.std()
    return float(np.mean((a - a.mean()) * (b - b.mean())) / spread) if spread > 0.0 else 0.0


def _lag(dataset: Dataset, cause: NDArray[np.float64], effect: NDArray[np.float64]) -> float:
    """Periods by which `effect` follows `cause`: the lag of their largest correlation."""
    longest = round(_LONGEST / dataset.provenance.dt)
    rows = np.arange(longest, len(cause) - longest)
    unbroken = dataset.unbroken(2 * longest)
    rows = rows[unbroken & dataset.counts[rows]]
    if len(rows) == 0:
        return float("nan")
    lags = np.arange(-longest, longest + 1)
    values = [_correlation(cause[rows], effect[rows + lag]) for lag in lags]
    return float(lags[int(np.argmax(values))])
