"""How much the errors of consecutive transitions repeat one another."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.quantities import NY

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset

_LONGEST_LAG: Final = 50  # periods
_LEAST_CORRELATION: Final = 0.05


def autocorrelation(errors: NDArray[np.float64], data: Dataset) -> NDArray[np.float64]:
    """Return the sum of the autocorrelations (3,) of errors (n, 3) over positive lags.

    Pairs are those within a trajectory, and the sum ends where the correlation falls below 0.05.
    """
    centred = errors - np.median(errors, axis=0)
    # Outliers have no neighbours like them, and would hide the correlation of the others.
    centred = np.clip(centred, *np.quantile(centred, [0.025, 0.975], axis=0))
    total, rising = np.zeros(NY), np.ones(NY, dtype=bool)
    for lag in range(1, min(_LONGEST_LAG, len(errors))):
        together = data.unbroken(lag)
        if not together.any():
            break
        product = (centred[lag:] * centred[:-lag])[together].mean(axis=0)
        correlation = product / np.maximum(centred.var(axis=0), np.finfo(float).tiny)
        rising &= correlation > _LEAST_CORRELATION
        total += np.where(rising, correlation, 0.0)
    return total
