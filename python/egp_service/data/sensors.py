"""Sensors of a real car on the data of a simulated one: filter, delay, noise and quantisation."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from egp_service._core import EgpError
from egp_service.data.alignment import consecutive
from egp_service.quantities import NY

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset


@dataclasses.dataclass(frozen=True)
class Sensors:
    """What is measured of `[v_x, v_y, omega]`, in m/s, m/s and rad/s."""

    noise: tuple[float, float, float] = (0.02, 0.01, 0.001)
    """Standard deviations of white noise, after the filter."""
    quantum: tuple[float, float, float] = (0.01, 0.005, 0.0005)
    """Steps of the measured values."""
    cutoff: float = 5.0
    """Frequency in Hz at which the first-order filter of the sensors halves the power."""
    delay: int = 1
    """Periods by which the measured states are late."""

    def __post_init__(self) -> None:
        """Check the ranges of the values."""
        if min(self.noise) < 0.0 or min(self.quantum) <= 0.0:
            raise EgpError("sensors: expected noise of at least 0 and positive quanta")
        if self.cutoff <= 0.0 or self.delay < 0:
            raise EgpError("sensors: expected a positive cutoff in Hz and a delay of 0 or more")


def measure(dataset: Dataset, sensors: Sensors, rng: np.random.Generator) -> Dataset:
    """Return the transitions as the sensors measure them; steering angles and inputs stay exact.

    Where a trajectory begins, the sensors have measured its first state for a long time.
    """
    z, y, by_gravity = dataset.z.copy(), dataset.y.copy(), dataset.by_gravity
    for rows in consecutive(dataset):
        end = dataset.z[rows[-1], :NY] + y[rows[-1]] + by_gravity[rows[-1]]
        exact = np.vstack([dataset.z[rows, :NY], end])
        measured = _measured(exact, dataset.provenance.dt, sensors, rng)
        z[rows, :NY], y[rows] = measured[:-1], np.diff(measured, axis=0) - by_gravity[rows]
    return dataclasses.replace(dataset, z=z, y=y)


def _measured(
    exact: NDArray[np.float64], dt: float, sensors: Sensors, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Measured states (n, 3) of consecutive exact ones (n, 3)."""
    share = 1.0 - math.exp(-2.0 * math.pi * sensors.cutoff * dt)
    filtered, last = np.empty_like(exact), exact[0]
    for k, state in enumerate(exact):
        last = last + share * (state - last)
        filtered[k] = last
    late = np.vstack([np.repeat(exact[:1], sensors.delay, axis=0), filtered])[: len(exact)]
    noisy = late + np.array(sensors.noise) * rng.standard_normal(exact.shape)
    quantum = np.array(sensors.quantum)
    return np.asarray(quantum * np.round(noisy / quantum))
