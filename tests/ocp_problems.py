"""Optimal control problems of a vehicle beside a bend, for the tests of `solve_ocp`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from egp_service.optimal_control import OcpBounds, OcpWeights

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Problem = dict[str, Array]

DT = 0.05
SOLVERS: list[Literal["riccati", "clarabel"]] = ["riccati", "clarabel"]


def dynamics(rng: np.random.Generator, v: float, psi: float) -> tuple[Array, Array, Array]:
    """Linearise a single-track vehicle at speed `v`, heading `psi`, noise in its tyres."""
    a = np.eye(7)
    a[0, [2, 3, 4]] = np.array([np.cos(psi), -v * np.sin(psi), -np.sin(psi)]) * DT
    a[1, [2, 3, 4]] = np.array([np.sin(psi), v * np.cos(psi), np.cos(psi)]) * DT
    a[:2, 5] = 0.5 * DT * a[:2, 3]
    a[3, 5] = DT
    grip = 60.0 * rng.uniform(0.3, 1.2)
    lateral = np.array([-2.0 / v, -v / grip - 0.5 / v, 1.0]) * grip * DT
    yaw = np.array([0.3 / v, -2.2 / v, 0.9]) * grip * DT
    a[2, [2, 4, 5, 6]] += rng.normal(size=4) * 0.02
    a[4, [4, 5, 6]] += lateral
    a[5, [4, 5, 6]] += yaw
    a[[4, 5], 2] += rng.normal(size=2) * 0.01
    b = np.zeros((7, 2))
    b[2], b[4], b[5] = [0.9 * DT, 0.003], [0.002, 0.004], [0.001, 0.01]
    b[6, 1] = DT
    return a, b, rng.normal(size=7) * [0.0, 0.0, 0.02, 0.0, 0.02, 0.02, 0.0]


def problem(seed: int, horizon: int, n_soft: int) -> Problem:
    """Put a vehicle beside a bend of 40 m radius; most instances have active bounds."""
    rng = np.random.default_rng(seed)
    v = rng.uniform(6.0, 25.0)
    angle = v * DT * np.arange(1, horizon + 1) / 40.0
    zero = np.zeros(horizon)
    reference = np.stack(
        [40 * np.sin(angle), 40 * (1 - np.cos(angle)), zero + v, angle, zero, zero, zero], axis=1
    )
    a, b, c = (
        np.stack(m)
        for m in zip(*(dynamics(rng, v, psi) for psi in [0.0, *angle[:-1]]), strict=True)
    )
    # The affine part of the position rows, about the reference.
    c[:, 0] += v * angle * np.sin(np.r_[0.0, angle[:-1]]) * DT
    c[:, 1] -= v * angle * np.cos(np.r_[0.0, angle[:-1]]) * DT
    q = np.zeros((horizon, 7, 7))
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.stack([np.stack([cos, -sin], 1), np.stack([sin, cos], 1)], 1)
    q[:, :2, :2] = turn @ np.diag([10.0, 20.0]) @ turn.transpose(0, 2, 1)
    q[:, 2, 2], q[:, 3, 3] = 2.0, 10.0
    q[-1] *= 2.0
    q = 0.5 * (q + q.transpose(0, 2, 1))
    normal = np.zeros((horizon, 5, 7))
    normal[:, 0, 2] = normal[:, 1, 6] = normal[:, 3, 4] = normal[:, 4, 5] = 1.0
    normal[:, 2, 0], normal[:, 2, 1] = -sin, cos
    middle = np.einsum("tx,tx->t", normal[:, 2], reference)
    half = rng.uniform(0.1, 1.0)
    lower = np.stack([zero, zero - 0.3, middle - half, zero - 1.0, zero - 0.6], 1)
    upper = np.stack([zero + v + 0.5, zero + 0.3, middle + half, zero + 1.0, zero + 0.6], 1)
    limit = np.array([6.0, 0.4])
    return {
        "a": a,
        "b": b,
        "c": c,
        "q": q,
        "reference": reference,
        "x0": np.array([0, 0, v, 0, 0, 0, 0]) + rng.normal(size=7) * [0, 1, 2, 0.1, 0.3, 0.2, 0.05],
        "u_prev": rng.uniform(-1, 1, 2) * limit,
        "r": np.array([0.05, 2.0]),
        "r_d": np.array([0.05, 5.0]),
        "u_min": np.tile(-limit, (horizon, 1)),
        "u_max": np.tile([6.0, 0.4], (horizon, 1)),
        "du_min": np.tile([-3.0, -0.1], (horizon, 1)),
        "du_max": np.tile([3.0, 0.1], (horizon, 1)),
        "soft_normal": normal,
        "soft_lower": lower,
        "soft_upper": upper,
        "penalty": np.tile([50.0, 500.0], (n_soft, 1)),
    }


def arguments(p: Problem) -> tuple[Any, ...]:
    """Return the arguments of `solve_ocp`."""
    names = ("q", "r", "r_d", "proximal", "planned")
    weights = OcpWeights(**{name: p[name] for name in names if name in p})
    n_soft = len(p["penalty"])
    bounds = OcpBounds(
        **{name: p[name] for name in ("u_min", "u_max", "du_min", "du_max", "penalty")},
        soft_normal=p["soft_normal"][..., :n_soft, :],
        **{name: p[name][:, :n_soft] for name in ("soft_lower", "soft_upper")},
    )
    return p["a"], p["b"], p["c"], p["x0"], p["u_prev"], p["reference"], weights, bounds
