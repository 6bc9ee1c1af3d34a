"""Solutions of the optimal control problem against OSQP and PIQP.

OSQP gets the sparse form that Clarabel gets. PIQP gets the problem as written here once more, from
the formula alone: states instead of errors, other order, other code.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import osqp
import piqp
import pytest
from scipy import sparse

from egp_service._core import EgpError, InvalidArgumentError
from egp_service.optimal_control import ocp_to_qp, solve_ocp
from ocp_problems import SOLVERS, arguments, problem

if TYPE_CHECKING:
    from ocp_problems import Array, Problem

# Of states (m, m/s, rad) and scaled inputs (m/s², rad/s). Measured: PIQP 2e-6, OSQP 3e-6.
TOLERANCE = 1e-5


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
        ("a", np.empty((0, 7, 7)), "at least one stage"),
        ("u_min", np.full(2, 100.0), r"stage 0: .*u_min\[0\] = 100 and u_max\[0\] = 6"),
        ("c", np.full(7, np.nan), r"c\[0\]: expected a finite number, got NaN"),
        ("u_prev", [0.0, np.inf], r"u_prev\[1\]: expected a finite number, got inf"),
        ("q", -np.eye(7), "stage 0: .*semidefinite"),
        ("q", np.eye(7) + np.eye(7, k=2), r"symmetric q, got q\[0, 2\] = 1 and q\[2, 0\] = 0"),
        ("q", np.ones((7, 7)), r"q\[0, 2\] = 0, got 1: row 0 of q .* columns \[0, 1\]"),
        ("r", np.array([0.1, np.inf]), "finite r"),
        ("proximal", np.array([0.1, -1.0]), "proximal of at least 0"),
        ("a", np.ones((10, 7, 7)), r"stage 0: expected A\[0, 1\] = 0, got 1"),
        ("b", np.ones((7, 2)), r"B\[0, 0\] = 0, got 1: row 0 of B"),
        ("soft_normal", np.ones((3, 7)), r"soft_normal\[0, 0\] = 0, got 1: .* columns \[2\]"),
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
