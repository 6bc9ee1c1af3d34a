"""Small datasets with a known law, for tests of training without a plant."""

from __future__ import annotations

import numpy as np

from egp_service._core import VehicleParameters
from egp_service.data.dataset import Dataset
from egp_service.data.provenance import Provenance

# The vehicle that the data are said to come from.
TOY = VehicleParameters.commonroad(2)
NOISE = 0.002
STEPS = 20


def provenance(friction: float = 0.5, **changes: object) -> Provenance:
    fields: dict[str, object] = {
        "dt": 0.05,
        "vehicle": "toy",
        "surface": f"mu {friction:g}",
        "friction": friction,
        "seed": 0,
        "method": "formula",
        "tool": "test",
    }
    return Provenance(**(fields | changes))  # type: ignore[arg-type]


def surface(friction: float = 0.5, trajectories: int = 30, seed: int = 0) -> Dataset:
    """Return transitions of a car whose tyres saturate at the friction, with a little noise."""
    rng = np.random.default_rng(seed)
    n = trajectories * STEPS
    half = np.array([10.0, 1.0, 0.8, 0.3, 8000.0, 0.4])
    z = np.array([15.0, 0.0, 0.0, 0.0, 0.0, 0.0]) + half * rng.uniform(-1.0, 1.0, (n, 6))
    v_x, v_y, omega, delta, force, _ = z.T
    grip = friction * 9.81
    y = 0.05 * np.column_stack(
        [
            grip * np.tanh(force / (1225.0 * grip)) + v_y * omega,
            grip * np.tanh((20.0 * delta - 5.0 * v_y) / grip) - 0.1 * v_x * omega,
            grip * np.tanh(3.0 * (delta - omega)),
        ]
    )
    return Dataset(
        z=z,
        y=y + NOISE * rng.standard_normal(y.shape),
        trajectory=np.repeat(np.arange(trajectories, dtype=np.uint32), STEPS),
        step=np.tile(np.arange(STEPS, dtype=np.uint32), trajectories),
        provenance=provenance(friction),
    )
