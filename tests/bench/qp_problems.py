"""Optimal control problems of a car that follows a winding road, and a check of their solutions.

A drive is a closed loop: a single-track car with saturating tyres, linearised at each step about
its last plan, on a road whose bends ask for about its grip; the true car has another grip and is
measured with noise. The check knows nothing of any solver: it judges the inputs alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import lsq_linear

from egp_service._core import OcpBounds, OcpWeights, solve_ocp

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Problem = dict[str, Array]

DT = 0.05
SLEW = np.array([3.0, 0.4])
LIMIT = np.array([[-8.0, -0.4], [6.0, 0.4]])
# Rows farther than this from their bound have a negligible multiplier.
NEAR = 1e-2


@dataclass
class Step:
    """A problem and whether it is the first of its drive."""

    problem: Problem
    first: bool


def advance(x: Array, u: Array, grip: float) -> Array:
    """Return the states (n, 7) one period after `x` (n, 7) under `u` (n, 2)."""
    _, _, v_x, psi, v_y, omega, delta = x.T
    change = np.zeros_like(x)
    middle = psi + 0.5 * DT * omega
    change[:, 0] = v_x * np.cos(middle) - v_y * np.sin(middle)
    change[:, 1] = v_x * np.sin(middle) + v_y * np.cos(middle)
    change[:, 3] = omega
    change[:, 6] = u[:, 1]
    h = DT / 10
    for k in range(10):
        angle = delta + k * h * u[:, 1]
        speed = np.maximum(v_x, 1.0)
        front = 4.9 * grip * np.tanh(9.0 * (angle - (v_y + 0.9 * omega) / speed))
        rear = 4.9 * grip * np.tanh(11.0 * (1.5 * omega - v_y) / speed)
        acceleration = u[:, 0] + v_y * omega - front * np.sin(angle)
        lateral = front * np.cos(angle) + rear - v_x * omega
        yaw = 0.75 * (0.9 * front - 1.1 * rear)
        v_x, v_y, omega = v_x + h * acceleration, v_y + h * lateral, omega + h * yaw
    result = x + DT * change
    result[:, 2], result[:, 4], result[:, 5] = v_x, v_y, omega
    return result


def linearise(x: Array, u: Array, grip: float) -> tuple[Array, Array, Array]:
    """Return A (n, 7, 7), B (n, 7, 2), c (n, 7) about states `x` (n, 7) and inputs `u` (n, 2)."""
    z = np.hstack([x, u])
    wide = np.zeros((len(x), 7, 9))
    for j in range(9):
        step = np.zeros(9)
        step[j] = 1e-6
        up, down = z + step, z - step
        wide[:, :, j] = (
            advance(up[:, :7], up[:, 7:], grip) - advance(down[:, :7], down[:, 7:], grip)
        ) / 2e-6
    # Remove the rounding of differences where the equations have no entry.
    wide[:, [0, 1, 3, 6], :] = np.round(wide[:, [0, 1, 3, 6], :], 7)
    a, b = wide[:, :, :7].copy(), wide[:, :, 7:].copy()
    c = advance(x, u, grip) - np.einsum("tij,tj->ti", a, x) - np.einsum("tij,tj->ti", b, u)
    return a, b, c


def road(rng: np.random.Generator, v: float, grip: float, length: int) -> Array:
    """Return `[x, y, psi]` every `v * DT` m along bends and straights."""
    bends: list[float] = []
    while len(bends) < length:
        bend = rng.uniform(-1.0, 1.0) * 9.0 * grip / v**2 * rng.choice([0.0, 1.0, 1.0])
        bends += [bend] * int(rng.integers(10, 40))
    bend = np.convolve(bends[:length], np.ones(8) / 8, mode="same")
    psi = np.cumsum(bend * v * DT)
    return np.stack([np.cumsum(np.cos(psi)) * v * DT, np.cumsum(np.sin(psi)) * v * DT, psi], 1)


def to_local(rows: Array, x: Array) -> Array:
    """Turn `[x, y, psi]` rows on the map into the frame of the car at `x`."""
    sin, cos = np.sin(x[3]), np.cos(x[3])
    offset = rows - [x[0], x[1], x[3]]
    turned = np.stack(
        [cos * offset[:, 0] + sin * offset[:, 1], -sin * offset[:, 0] + cos * offset[:, 1]], 1
    )
    return np.hstack([turned, offset[:, 2:]])


def assemble(
    ahead: Array, x: Array, u_prev: Array, guess: Array, *, v: float, grip: float
) -> Problem:
    """Write the problem for road rows `ahead` (T, 3) and the car at `x`, all in the car's frame."""
    horizon = len(ahead)
    operating = [x]
    for u in guess[:-1]:
        operating.append(advance(operating[-1][None], u[None], grip)[0])
    a, b, c = linearise(np.array(operating), guess, grip)
    sin, cos = np.sin(ahead[:, 2]), np.cos(ahead[:, 2])
    zero = np.zeros(horizon)
    reference = np.stack([ahead[:, 0], ahead[:, 1], zero + v, ahead[:, 2], zero, zero, zero], 1)
    turn = np.stack([np.stack([cos, -sin], 1), np.stack([sin, cos], 1)], 1)
    q = np.zeros((horizon, 7, 7))
    q[:, :2, :2] = turn @ np.diag([10.0, 20.0]) @ turn.transpose(0, 2, 1)
    q[:, 2, 2], q[:, 3, 3] = 2.0, 10.0
    q[-1] *= 2.0
    q = 0.5 * (q + q.transpose(0, 2, 1))
    normal = np.zeros((horizon, 5, 7))
    normal[:, 0, 2] = normal[:, 1, 6] = normal[:, 3, 4] = normal[:, 4, 5] = 1.0
    normal[:, 2, 0], normal[:, 2, 1] = -sin, cos
    middle = np.einsum("tx,tx->t", normal[:, 2], reference)
    lower = np.stack([zero, zero - 0.6, middle - 0.6, zero - 1.5, zero - 0.9], 1)
    upper = np.stack([zero + v + 0.5, zero + 0.6, middle + 0.6, zero + 1.5, zero + 0.9], 1)
    return {
        "a": a,
        "b": b,
        "c": c,
        "q": q,
        "reference": reference,
        "x0": x,
        "u_prev": u_prev,
        "r": np.array([0.05, 2.0]),
        "r_d": np.array([0.05, 5.0]),
        "u_min": np.tile(LIMIT[0], (horizon, 1)),
        "u_max": np.tile([min(LIMIT[1, 0], 54.7 / max(x[2], 1.0)), LIMIT[1, 1]], (horizon, 1)),
        "du_min": np.tile(-SLEW, (horizon, 1)),
        "du_max": np.tile(SLEW, (horizon, 1)),
        "soft_normal": normal,
        "soft_lower": lower,
        "soft_upper": upper,
        "penalty": np.tile([200.0, 2000.0], (5, 1)),
    }


def arguments(p: Problem) -> tuple[Any, ...]:
    """Return the arguments of `solve_ocp`."""
    weights = OcpWeights(**{name: p[name] for name in ("q", "r", "r_d")})
    n_soft = len(p["penalty"])
    bounds = OcpBounds(
        **{name: p[name] for name in ("u_min", "u_max", "du_min", "du_max", "penalty")},
        **{name: p[name][:, :n_soft] for name in ("soft_normal", "soft_lower", "soft_upper")},
    )
    return p["a"], p["b"], p["c"], p["x0"], p["u_prev"], p["reference"], weights, bounds


def drive(seed: int, horizon: int, steps: int) -> Iterator[Step]:
    """Yield the problems of consecutive steps; their solutions drive the car."""
    rng = np.random.default_rng(seed)
    v = rng.uniform(8.0, 22.0)
    grip = rng.uniform(0.5, 1.1)
    true_grip = grip * rng.uniform(0.8, 1.2)
    way = road(rng, v, grip, steps + horizon + 1)
    x = np.array([*way[0, :2], v, way[0, 2], 0.0, 0.0, 0.0])
    x += rng.normal(size=7) * [0.2, 0.5, 1.0, 0.08, 0.2, 0.1, 0.02]
    u, guess = np.zeros(2), np.zeros((horizon, 2))
    for step in range(steps):
        local = np.array([0.0, 0.0, x[2], 0.0, x[4], x[5], x[6]])
        ahead = to_local(way[step + 1 : step + horizon + 1], x)
        problem = assemble(ahead, local, u, guess, v=v, grip=grip)
        yield Step(problem, first=step == 0)
        plan = solve_ocp(*arguments(problem)).u
        u = plan[0]
        guess = np.vstack([plan[1:], plan[-1:]])
        x = advance(x[None], u[None], true_grip)[0]
        x += rng.normal(size=7) * [0.01, 0.01, 0.02, 0.002, 0.02, 0.01, 0.0]


@dataclass
class Condensed:
    """A problem in its inputs alone: states = `gain` u + `free`, row values = `rows` u + `at`."""

    gain: Array
    free: Array
    difference: Array
    first: Array

    @classmethod
    def of(cls, p: Problem) -> Condensed:
        """Eliminate the states."""
        horizon = len(p["c"])
        gain, free = np.zeros((horizon, 7, 2 * horizon)), np.zeros((horizon, 7))
        x, g = p["x0"], np.zeros((7, 2 * horizon))
        for t in range(horizon):
            x, g = p["a"][t] @ x + p["c"][t], p["a"][t] @ g
            g[:, 2 * t : 2 * t + 2] += p["b"][t]
            gain[t], free[t] = g, x
        difference = np.eye(2 * horizon) - np.eye(2 * horizon, k=-2)
        first = np.r_[p["u_prev"], np.zeros(2 * horizon - 2)]
        return cls(gain, free, difference, first)

    def smooth(self, p: Problem) -> tuple[Array, Array]:
        """Return Hessian and gradient at zero of the cost without slacks."""
        weighted = p["q"] @ self.gain
        horizon = len(p["c"])
        rate = np.tile(p["r_d"], horizon)
        hessian = np.einsum("tia,tib->ab", self.gain, weighted, optimize=True)
        hessian += np.diag(np.tile(p["r"], horizon))
        hessian += self.difference.T @ (rate[:, None] * self.difference)
        gradient = np.einsum("tia,ti->a", weighted, self.free - p["reference"])
        gradient -= self.difference.T @ (rate * self.first)
        return 0.5 * (hessian + hessian.T), gradient

    def soft(self, p: Problem) -> tuple[Array, Array]:
        """Return the soft rows (5T, 2T) and their values without inputs."""
        rows = p["soft_normal"] @ self.gain
        at = np.einsum("tjx,tx->tj", p["soft_normal"], self.free)
        return rows.reshape(-1, rows.shape[2]), at.ravel()


def residual(p: Problem, inputs: Array) -> float:
    """Return the largest KKT residual that these inputs (T, 2) must have, whatever the multipliers.

    The multipliers that fit best are found by bounded least squares on gradient and
    complementarity; the gradient is relative to its largest term, at least 1.
    """
    if not np.isfinite(inputs).all():
        return float("inf")
    u = inputs.ravel()
    condensed = Condensed.of(p)
    hessian, linear = condensed.smooth(p)
    gradient = hessian @ u + linear
    terms: list[float] = [np.abs(hessian @ u).max(), np.abs(linear).max()]
    rows, at = condensed.soft(p)
    value = rows @ u + at
    du = condensed.difference @ u - condensed.first
    hard = np.eye(len(u))
    columns: list[Array] = []
    distances: list[float] = []
    limits: list[float] = []

    def side(normals: Array, gaps: Array, limit: Array) -> None:
        for normal, gap, most in zip(normals, gaps, limit, strict=True):
            if abs(gap) < NEAR:
                columns.append(normal)
                distances.append(abs(float(gap)))
                limits.append(float(most))

    free = np.full(len(u), np.inf)
    gaps = [
        p["u_max"].ravel() - u,
        u - p["u_min"].ravel(),
        p["du_max"].ravel() - du,
        du - p["du_min"].ravel(),
    ]
    normals = [hard, -hard, condensed.difference, -condensed.difference]
    for normal, gap in zip(normals, gaps, strict=True):
        side(normal, gap, free)
    price, curve = np.tile(p["penalty"], (len(p["c"]), 1)).T
    for sign, bound in ((1.0, p["soft_upper"]), (-1.0, p["soft_lower"])):
        gap = sign * (bound.ravel() - value)
        violation = np.maximum(-gap, 0.0)
        force = np.where(violation > 0.0, price + curve * violation, 0.0)
        # The multiplier of a row on its bound lies between zero and its penalty.
        edge = violation < 1e-6
        force[edge] = 0.0
        side(sign * rows, np.where(edge, np.maximum(gap, 0.0), np.inf), price)
        gradient = gradient + (sign * rows).T @ force
        terms.append(float(np.abs((sign * rows).T @ force).max()))
    scale: float = max(1.0, *terms)
    primal: float = max(0.0, *(float(-gap.min()) for gap in gaps))
    if not columns:
        return max(primal, float(np.abs(gradient).max()) / scale)
    matrix = np.vstack([np.array(columns).T, np.diag(distances)]) / scale
    target = np.r_[-gradient, np.zeros(len(columns))] / scale
    fit = lsq_linear(matrix, target, (0.0, np.maximum(limits, 1e-300)), method="bvls", tol=1e-14)
    worst: float = np.abs(fit.fun).max()
    return max(primal, worst)
