"""A small valid library for tests, predicted by textbook formulas in numpy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from egp_service._core import MemberData, VehicleParameters, write_library

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

# Centre and half width of the sampled GP inputs [v_x, v_y, omega, delta, F_x, delta_dot].
CENTRE = np.array([15.0, 0.0, 0.0, 0.0, 0.0, 0.0])
HALF_WIDTH = np.array([10.0, 1.0, 0.8, 0.3, 8000.0, 0.4])


def write_example(
    path: Path,
    *,
    frictions: tuple[float, ...] = (0.5, 1.1),
    n: int = 30,
    vehicle: VehicleParameters | None = None,
    measurement_noise: Array | None = None,
    measurement_delay: float | None = None,
) -> None:
    """Write a library of RBF members, one for each friction coefficient.

    It is for `vehicle`, or for the simulated car, and states `measurement_noise` and
    `measurement_delay` if they are given.
    """
    members = [
        MemberData(**member_arrays(friction, n, seed=i)) for i, friction in enumerate(frictions)
    ]
    write_library(
        path,
        dt=0.05,
        kernel="rbf",
        vehicle="commonroad-1",
        parameters=vehicle or VehicleParameters.commonroad(1),
        members=members,
        provenance={"source": "tests"},
        measurement_noise=measurement_noise,
        measurement_delay=measurement_delay,
    )


def member_arrays(
    friction: float, n: int, seed: int, *, one_kernel: bool = False
) -> dict[str, Any]:
    """Arguments of `MemberData` for GPs on random samples of a caricature of a vehicle.

    With `one_kernel` all outputs have the second one's kernel and noise, as in trained libraries.
    """
    rng = np.random.default_rng(seed)
    inputs = CENTRE + HALF_WIDTH * rng.uniform(-1.0, 1.0, (n, 6))
    targets = change(inputs, friction) + rng.normal(0.0, 0.003, (n, 3))
    arrays = {
        "label": f"friction {friction}",
        "friction": friction,
        "dataset": "none",
        "inputs": inputs,
        "targets": targets,
        "input_mean": inputs.mean(axis=0),
        "input_std": inputs.std(axis=0),
        "target_mean": targets.mean(axis=0),
        "target_std": targets.std(axis=0),
        "lengthscales": rng.uniform(1.0, 4.0, (3, 6)),
        "outputscale": np.array([1.5, 0.8, 1.1]),
        "noise": np.array([1e-3, 2e-3, 5e-3]),
        "constant": np.array([0.1, 0.0, -0.2]),
        "envelope": np.stack([inputs.min(axis=0), inputs.max(axis=0)]),
    }
    if one_kernel:
        for name in ("lengthscales", "outputscale", "noise"):
            arrays[name] = np.repeat(arrays[name][1:2], 3, axis=0)
    spread = np.repeat([1.0, 10.0], 3)[:, None]
    golden_z = CENTRE + spread * HALF_WIDTH * rng.uniform(-1.0, 1.0, (6, 6))
    alpha, mean, jacobian, variance = zip(
        *(predict(arrays, o, golden_z) for o in range(3)), strict=True
    )
    arrays |= {
        "alpha": np.stack(alpha),
        "golden_z": golden_z,
        "golden_mean": np.stack(mean, axis=1),
        "golden_jacobian": np.stack(jacobian, axis=1),
        "golden_variance": np.stack(variance, axis=1),
    }
    return arrays


def change(z: Array, friction: float) -> Array:
    """Return a saturating response of [v_x, v_y, omega] over one period, not a real vehicle's."""
    v_x, v_y, omega, delta, force, delta_dot = z.T
    front = friction * np.tanh(5.0 * (delta - (v_y + 0.9 * omega) / v_x))
    rear = friction * np.tanh(-5.0 * (v_y - 1.5 * omega) / v_x)
    return np.stack(
        [
            0.05 * (force / 1226.0 + v_y * omega - 2.0 * front * delta),
            0.05 * (4.0 * (front + rear) - v_x * omega) + 0.002 * delta_dot,
            0.05 * (6.0 * front - 7.0 * rear),
        ],
        axis=1,
    )


def predict(arrays: dict[str, Any], output: int, z: Array) -> tuple[Array, Array, Array, Array]:
    """Return alpha of one output, and at `z` the mean, its gradient and the latent variance."""
    lengths = arrays["input_std"] * arrays["lengthscales"][output]
    scale, shift = arrays["target_std"][output], arrays["target_mean"][output]
    prior, constant = arrays["outputscale"][output], arrays["constant"][output]

    def kernel(a: Array, b: Array) -> Array:
        r2 = (((a[:, None] - b[None]) / lengths) ** 2).sum(axis=2)
        return np.asarray(prior * np.exp(-0.5 * r2))

    x = arrays["inputs"]
    factor = cho_factor(kernel(x, x) + arrays["noise"][output] * np.eye(len(x)))
    alpha = cho_solve(factor, (arrays["targets"][:, output] - shift) / scale - constant)
    k = kernel(z, x)
    slopes = -k[:, :, None] * (z[:, None] - x[None]) / lengths**2
    mean = shift + scale * (constant + k @ alpha)
    gradient = scale * np.einsum("gmd,m->gd", slopes, alpha)
    variance = scale**2 * (prior - (k * cho_solve(factor, k.T).T).sum(axis=1))
    return alpha, mean, gradient, variance
