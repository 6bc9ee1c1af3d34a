"""Solutions of the optimal control problem against OSQP and PIQP.

OSQP gets the sparse form that Clarabel gets. PIQP gets the problem as written here once more, from
the formula alone: states instead of errors, other order, other code.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import osqp
import piqp
import pytest
from scipy import sparse

from egp_service._core import (
    EgpError,
    InvalidArgumentError,
    OcpBounds,
    OcpWeights,
    solve_ocp,
)
from egp_service._core.testing import ocp_to_qp

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Problem = dict[str, Array]

# Of states (m, m/s, rad) and scaled inputs (m/s², rad/s). Measured: PIQP 2e-6, OSQP 3e-6.
TOLERANCE = 1e-5
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
    weights = OcpWeights(**{name: p[name] for name in ("q", "r", "r_d")})
    n_soft = len(p["penalty"])
    bounds = OcpBounds(
        **{name: p[name] for name in ("u_min", "u_max", "du_min", "du_max", "penalty")},
        **{name: p[name][:, :n_soft] for name in ("soft_normal", "soft_lower", "soft_upper")},
    )
    return p["a"], p["b"], p["c"], p["x0"], p["u_prev"], p["reference"], weights, bounds


def by_osqp(p: Problem) -> tuple[Array, Array]:
    """Solve the exported sparse form."""
    (pv, pi, ps), q, (av, ai, as_), lower, upper = ocp_to_qp(*arguments(p))
    n, m = len(q), len(lower)
    solver = osqp.OSQP()
    solver.setup(
        sparse.csc_matrix((pv, pi, ps), shape=(n, n)),
        q,
        sparse.csc_matrix((av, ai, as_), shape=(m, n)),
        lower,
        upper,
        eps_abs=1e-9,
        eps_rel=1e-9,
        # With three soft rows it stalls on some, after 5000 iterations or fewer.
        max_iter=20_000 if len(p["penalty"]) == 3 else 200_000,
        polishing=True,
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    # On some of these it stalls at residuals of 1e-8, before its own tolerance: no verdict on its
    # status, agreement is what counts.
    stages = result.x.reshape(len(p["c"]), -1)
    return stages[:, 2:9] + p["reference"], stages[:, :2]


def by_piqp(p: Problem) -> tuple[Array, Array]:
    """Assemble and solve with z = [x_1..x_T, u_0..u_{T-1}, s_1..s_T]."""
    horizon, n_soft = len(p["c"]), len(p["penalty"])
    nx, nu, ns = 7 * horizon, 2 * horizon, n_soft * horizon
    difference = np.eye(nu) - np.eye(nu, k=-2)
    first = np.r_[p["u_prev"], np.zeros(nu - 2)]
    weight = np.diag(np.tile(p["r_d"], horizon))
    hessian = sparse.block_diag(
        [
            *p["q"],
            np.diag(np.tile(p["r"], horizon)) + difference.T @ weight @ difference,
            np.diag(np.tile(p["penalty"][:, 1], horizon)),
        ],
        format="csc",
    )
    linear = np.r_[
        -np.einsum("tij,tj->ti", p["q"], p["reference"]).ravel(),
        -difference.T @ weight @ first,
        np.tile(p["penalty"][:, 0], horizon),
    ]
    transition = np.eye(nx)
    for t in range(1, horizon):
        transition[7 * t : 7 * t + 7, 7 * t - 7 : 7 * t] = -p["a"][t]
    equalities = sparse.csc_matrix(
        np.hstack([transition, -sparse.block_diag(p["b"]).toarray(), np.zeros((nx, ns))])
    )
    offset = p["c"].copy()
    offset[0] += p["a"][0] @ p["x0"]
    normals = sparse.block_diag(p["soft_normal"][:, :n_soft]).toarray()
    rows = np.vstack(
        [
            np.hstack([np.zeros((nu, nx)), difference, np.zeros((nu, ns))]),
            np.hstack([normals, np.zeros((ns, nu)), np.eye(ns)]),
            np.hstack([normals, np.zeros((ns, nu)), -np.eye(ns)]),
        ]
    )
    lower, upper = p["soft_lower"][:, :n_soft].ravel(), p["soft_upper"][:, :n_soft].ravel()
    free = np.full(ns, np.inf)
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = 1e-11
    solver.settings.eps_duality_gap_abs = solver.settings.eps_duality_gap_rel = 1e-11
    solver.setup(
        hessian,
        linear,
        equalities,
        offset.ravel(),
        sparse.csc_matrix(rows),
        np.r_[p["du_min"].ravel() + first, lower, -free],
        np.r_[p["du_max"].ravel() + first, free, upper],
        np.r_[np.full(nx, -np.inf), p["u_min"].ravel(), np.zeros(ns)],
        np.r_[np.full(nx, np.inf), p["u_max"].ravel(), free],
    )
    assert solver.solve() == piqp.PIQP_SOLVED
    z = solver.result.x
    return z[:nx].reshape(-1, 7), z[nx : nx + nu].reshape(-1, 2)


@pytest.mark.parametrize(("horizon", "n_soft"), [(1, 3), (10, 3), (20, 3), (20, 5), (40, 5)])
def test_solutions_agree_with_osqp_and_piqp(horizon: int, n_soft: int) -> None:
    active = 0
    for seed in range(6):
        p = problem(seed, horizon, n_soft)
        others = [by_osqp(p), by_piqp(p)]
        for solver in SOLVERS:
            result = solve_ocp(*arguments(p), solver=solver)
            assert (result.status, result.solver.split()[0]) == ("solved", solver)
            assert result.kkt_residual < TOLERANCE
            x, u = result.x, result.u
            np.testing.assert_array_equal(x[0], p["x0"])
            for other_x, other_u in others:
                np.testing.assert_allclose(x[1:], other_x, rtol=0, atol=TOLERANCE)
                np.testing.assert_allclose(u, other_u, rtol=0, atol=TOLERANCE)
        gap = np.minimum(u - p["u_min"], p["u_max"] - u)
        steps = np.diff(np.vstack([p["u_prev"], u]), axis=0)
        gap = np.minimum(gap, np.minimum(steps - p["du_min"], p["du_max"] - steps))
        active += bool((gap < 1e-6).any())
    assert active >= 4, "the problems must be hard"


def test_arrays_without_stages_hold_for_all() -> None:
    p = problem(0, 10, 3)
    constant = p | {"u_min": p["u_min"][0], "c": p["c"][0], "penalty": p["penalty"][:0]}
    repeated = constant | {"u_min": p["u_min"], "c": np.tile(p["c"][0], (10, 1))}
    results = [solve_ocp(*arguments(each)) for each in (constant, repeated)]
    np.testing.assert_array_equal(results[0].u, results[1].u)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("a", np.eye(7), r"A of shape \(T, 7, 7\), got \(7, 7\)"),
        ("b", np.ones((9, 7, 2)), r"B of shape \(10, 7, 2\) or \(7, 2\), got \(9, 7, 2\)"),
        ("x0", np.ones(6), r"x0 of shape \(7,\), got \(6,\)"),
        ("r", np.zeros(2), "r > 0"),
        ("penalty", np.ones((6, 2)), "n <= 5"),
        ("penalty", np.ones((3, 1)), r"\(n, 2\)"),
        ("penalty", np.zeros((3, 2)), "penalty > 0"),
        ("soft_lower", np.zeros((10, 2)), r"soft_lower of shape \(10, 3\) or \(3,\)"),
        ("u_min", np.full(2, 100.0), "not above"),
        ("c", np.full(7, np.nan), "finite"),
        ("q", -np.eye(7), "semidefinite"),
        ("r", np.array([0.1, np.inf]), "finite r"),
        ("a", np.ones((10, 7, 7)), "entries of A"),
    ],
)
def test_a_problem_that_does_not_fit_is_refused(name: str, value: Array, message: str) -> None:
    with pytest.raises(EgpError, match=message):
        solve_ocp(*arguments(problem(0, 10, 3) | {name: value}))


@pytest.mark.parametrize("guess", [np.full((10, 2), np.nan), np.full((10, 2), np.inf)])
def test_a_guess_has_finite_numbers(guess: Array) -> None:
    with pytest.raises(InvalidArgumentError, match="guess: expected finite numbers"):
        solve_ocp(*arguments(problem(0, 10, 3)), guess=guess)


def test_soft_rows_with_another_coefficient_are_the_same_problem() -> None:
    factor = np.array([-2.0, 0.5, 1.0, -1.0, 1.5])
    for seed in range(8):
        p = problem(seed, 20, 5)
        ends = np.sort([p["soft_lower"] * factor, p["soft_upper"] * factor], axis=0)
        scaled = p | {
            "soft_normal": p["soft_normal"] * factor[:, None],
            **dict(zip(("soft_lower", "soft_upper"), ends, strict=True)),
            "penalty": p["penalty"] / np.stack([abs(factor), factor**2], axis=1),
        }
        one, other = solve_ocp(*arguments(p)), solve_ocp(*arguments(scaled))
        assert (other.status, other.solver) == ("solved", one.solver)
        np.testing.assert_allclose(other.u, one.u, rtol=0, atol=TOLERANCE)
