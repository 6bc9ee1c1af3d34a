"""Other QP solvers on the same problems, each as fast as its interface allows.

All but HPIPM and DAQP get the sparse form of `ocp_to_qp`, set up once a horizon and updated in
place; times are the solvers' own, without Python. Tolerances are the loosest that keep the KKT
residual of our check below 1e-6 on most problems.
"""

from __future__ import annotations

import importlib.util
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from qp_problems import Condensed, arguments
from scipy import sparse

from egp_service._core import solve_ocp
from egp_service.optimal_control import ocp_to_qp

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from qp_problems import Array, Problem, Step

TARGET = Path(__file__).parents[2] / "target"


@dataclass
class Answer:
    """Time and inputs (T, 2); the inputs are NaN if the solver failed."""

    seconds: float
    iterations: int
    u: Array


class Rival(Protocol):
    """A solver for the problems of one horizon, called in the order of the drives."""

    def __init__(self, repeats: int) -> None:
        """Return the solution with the shortest of `repeats` times."""

    def solve(self, step: Step, *, warm: bool) -> Answer:
        """Solve without a start, or from the solution of the previous problem."""


def missing(module: str) -> bool:
    """Return whether a package is not installed."""
    return importlib.util.find_spec(module) is None


class Ours:
    """`solve_ocp`; started from the shifted inputs of the last plan. Its check is in the time."""

    def __init__(self, repeats: int, kind: str = "riccati") -> None:
        self.repeats, self.kind = repeats, kind
        self.last: Array | None = None

    def solve(self, step: Step, *, warm: bool) -> Answer:
        """Solve a problem in the memory of the previous one."""
        guess = None
        if warm and self.last is not None:
            guess = np.vstack([self.last[1:], self.last[-1:]])
        kind: Any = self.kind
        result = solve_ocp(*arguments(step.problem), solver=kind, guess=guess, repeat=self.repeats)
        u = result.u if result.status == "solved" else np.full_like(result.u, np.nan)
        self.last = u
        return Answer(result.seconds, result.iterations, u)


def scipy_form(p: Problem) -> tuple[Any, Array, Any, Array, Array]:
    """Return P (upper), q, A, l, u."""
    (pv, pi, ps), q, (av, ai, as_), lower, upper = ocp_to_qp(*arguments(p))
    hessian = sparse.csc_matrix((pv, pi, ps), shape=(len(q), len(q)))
    return hessian, q, sparse.csc_matrix((av, ai, as_), shape=(len(lower), len(q))), lower, upper


def inputs(z: Array, horizon: int) -> Array:
    """Return the inputs (T, 2) in a vector of the sparse form."""
    return np.asarray(z).reshape(horizon, -1)[:, :2].copy()


def shifted(z: Array, horizon: int) -> Array:
    """Shift a vector with equal parts for each stage by one period; the last stage stays."""
    parts = z.reshape(horizon, -1)
    return np.vstack([parts[1:], parts[-1:]]).ravel()


class Osqp:
    """OSQP 1: ADMM with polishing, warm from the shifted solution."""

    def __init__(self, repeats: int) -> None:
        self.repeats = repeats
        self.solver: Any = None
        self.last: tuple[Array, Array] | None = None

    def solve(self, step: Step, *, warm: bool) -> Answer:
        """Solve a problem in the memory of the previous one."""
        import osqp  # noqa: PLC0415

        p, q, a, lower, upper = scipy_form(step.problem)
        if self.solver is None:
            self.solver = osqp.OSQP()
            self.solver.setup(
                p, q, a, lower, upper, eps_abs=1e-6, eps_rel=1e-6, max_iter=20_000,
                polishing=True, verbose=False,
            )  # fmt: skip
        self.solver.update(q=q, l=lower, u=upper, Px=p.data, Ax=a.data)
        horizon = len(step.problem["c"])
        start = (np.zeros(len(q)), np.zeros(len(lower)))
        if warm and self.last is not None:
            start = (shifted(self.last[0], horizon), shifted(self.last[1], horizon))
        best = np.inf
        for _ in range(self.repeats):
            self.solver.warm_start(x=start[0], y=start[1])
            result = self.solver.solve(raise_error=False)
            best = min(best, result.info.solve_time + result.info.polish_time)
        self.last = (np.array(result.x), np.array(result.y))
        return Answer(best, result.info.iter, inputs(result.x, horizon))


class Piqp:
    """PIQP with its multistage KKT solver; no warm start."""

    def __init__(self, repeats: int) -> None:
        self.repeats = repeats
        self.solver: Any = None

    def solve(self, step: Step, *, warm: bool) -> Answer:  # noqa: ARG002
        """Solve a problem in the memory of the previous one."""
        import piqp  # noqa: PLC0415

        p, q, a, lower, upper = scipy_form(step.problem)
        equal = lower == upper
        rows, bounds = a.tocsr(), (lower[~equal], upper[~equal])
        data = (p, q, rows[equal].tocsc(), lower[equal], rows[~equal].tocsc(), *bounds)
        if self.solver is None:
            self.solver = piqp.SparseSolver()
            options = self.solver.settings
            options.kkt_solver = piqp.KKTSolver.sparse_multistage
            options.eps_abs = options.eps_rel = 1e-8
            options.eps_duality_gap_abs = options.eps_duality_gap_rel = 1e-8
            options.compute_timings = True
            self.solver.setup(*data)
        else:
            self.solver.update(*data)
        best = np.inf
        for _ in range(self.repeats):
            self.solver.solve()
            best = min(best, self.solver.result.info.solve_time)
        result = self.solver.result
        return Answer(best, result.info.iter, inputs(result.x, len(step.problem["c"])))


class ProxQp:
    """ProxQP, sparse backend; warm from the shifted solution."""

    def __init__(self, repeats: int) -> None:
        self.repeats = repeats
        self.solver: Any = None
        self.last: list[Array] = []

    def solve(self, step: Step, *, warm: bool) -> Answer:
        """Solve a problem in the memory of the previous one."""
        from proxsuite import proxqp  # noqa: PLC0415

        p, q, a, lower, upper = scipy_form(step.problem)
        full = (p + sparse.triu(p, 1).T).tocsc()
        equal = lower == upper
        rows = a.tocsr()
        low, high = np.maximum(lower[~equal], -1e20), np.minimum(upper[~equal], 1e20)
        data = (full, q, rows[equal].tocsc(), lower[equal], rows[~equal].tocsc(), low, high)
        if self.solver is None:
            self.solver = proxqp.sparse.QP(len(q), int(equal.sum()), int((~equal).sum()))
            self.solver.settings.eps_abs = 1e-9
            self.solver.settings.eps_rel = 0.0
            self.solver.settings.max_iter, self.solver.settings.max_iter_in = 100, 300
            self.solver.settings.compute_timings = True
            self.solver.init(*data)
        else:
            self.solver.update(*data)
        horizon = len(step.problem["c"])
        start = [shifted(v, horizon) for v in self.last] if warm and self.last else None
        self.solver.settings.initial_guess = (
            proxqp.InitialGuess.WARM_START
            if start
            else proxqp.InitialGuess.EQUALITY_CONSTRAINED_INITIAL_GUESS
        )
        best = np.inf
        for _ in range(self.repeats):
            self.solver.solve(*start) if start else self.solver.solve()
            best = min(best, self.solver.results.info.solve_time * 1e-6)
        result = self.solver.results
        self.last = [np.array(result.x), np.array(result.y), np.array(result.z)]
        return Answer(best, result.info.iter, inputs(result.x, horizon))


class Daqp:
    """DAQP, condensed, with its own L1 + L2 soft rows; timed with set-up, without condensing."""

    def __init__(self, repeats: int) -> None:
        self.repeats = repeats
        self.last: Array | None = None

    def solve(self, step: Step, *, warm: bool) -> Answer:
        """Solve a problem in the memory of the previous one."""
        import daqp  # noqa: PLC0415

        p = step.problem
        condensed = Condensed.of(p)
        hessian, gradient = condensed.smooth(p)
        rows, at = condensed.soft(p)
        first, price = condensed.first, np.tile(p["penalty"], (len(p["c"]), 1))
        upper = np.r_[p["u_max"].ravel(), p["du_max"].ravel() + first, p["soft_upper"].ravel() - at]
        lower = np.r_[p["u_min"].ravel(), p["du_min"].ravel() + first, p["soft_lower"].ravel() - at]
        hard = 2 * len(first)
        sense = np.r_[np.zeros(hard), np.full(len(at), 8)].astype(np.int32)
        matrix = np.ascontiguousarray(np.vstack([condensed.difference, rows]))
        if warm and self.last is not None:
            sense = sense | (shifted_rows(self.last, len(first)) != 0).astype(np.int32)
        best = np.inf
        for _ in range(self.repeats):
            model = daqp.Model()
            _, setting_up = model.setup(hessian, gradient, matrix, upper, lower, sense)
            quadratic = np.r_[np.zeros(hard), 1.0 / price[:, 1]]
            linear = np.r_[np.zeros(hard), price[:, 0]]
            model.soft_weights(rho_l=quadratic, rho_u=quadratic, w_l=linear, w_u=linear)
            u, _, flag, info = model.solve()
            best = min(best, setting_up + info["solve_time"])
        self.last = np.array(info["lam"])
        u = np.array(u).reshape(-1, 2) if flag > 0 else np.full((len(p["c"]), 2), np.nan)
        return Answer(best, info["iterations"], u)


def shifted_rows(multipliers: Array, n: int) -> Array:
    """Move the multipliers of bounds, rates and soft rows by one period."""
    horizon = n // 2
    parts = (multipliers[:n], multipliers[n : 2 * n], multipliers[2 * n :])
    return np.concatenate([shifted(part, horizon) for part in parts])


class Hpipm:
    """HPIPM through `hpipm.c`: all problems at once, by a program built here."""

    def __init__(self, repeats: int) -> None:
        self.repeats = repeats
        spec = importlib.util.find_spec("acados")
        places = spec.submodule_search_locations if spec else None
        if not places:
            raise ModuleNotFoundError(name="acados")
        install = Path(places[0]) / "install"
        self.program = TARGET / "bench" / "hpipm"
        self.program.parent.mkdir(parents=True, exist_ok=True)
        include, lib = install / "include", install / "lib"
        folders = [f"-I{include / name / 'include'}" for name in ("hpipm", "blasfeo")]
        source = str(Path(__file__).with_name("hpipm.c"))
        # Unlike RUNPATH, RPATH in the program is also used for the dependencies of libhpipm.
        search = f"-Wl,--disable-new-dtags,-rpath,{lib}"
        libraries = [f"-L{lib}", "-lhpipm", "-lblasfeo", "-lm", search]
        subprocess.run(
            ["gcc", "-O2", source, *folders, *libraries, "-o", str(self.program)],  # noqa: S607
            check=True,
        )

    def solve_all(self, steps: Sequence[Step], *, warm: int, tolerance: float) -> list[Answer]:
        """Solve the problems of all drives; `warm` 1 starts the states and inputs, 2 all."""
        horizon = len(steps[0].problem["c"])
        data, results = self.program.with_suffix(".in"), self.program.with_suffix(".out")
        data.write_bytes(b"".join(pack(step) for step in steps))
        arguments = [horizon, len(steps), warm, tolerance, self.repeats]
        subprocess.run([self.program, data, results, *map(str, arguments)], check=True)
        rows = np.fromfile(results).reshape(len(steps), 3 + 2 * horizon)
        return [Answer(row[0], int(row[1]), row[3:].reshape(-1, 2)) for row in rows]


def pack(step: Step) -> bytes:
    """Write a problem as `hpipm.c` reads it, matrices by columns."""
    p = step.problem
    out: list[NDArray[np.float64]] = [np.array([float(step.first)]), p["u_prev"]]
    order = [0, 3, 4, 1]  # v_x, v_y, omega, delta of the soft rows
    for t in range(len(p["c"])):
        a = np.eye(9)
        a[:7, :7], a[:7, 7:] = p["a"][t], p["b"][t]
        b = np.vstack([p["b"][t], np.eye(2)])
        offset = np.r_[p["c"][t], 0.0, 0.0]
        if t == 0:
            offset = offset + a @ np.r_[p["x0"], p["u_prev"]]
        q = np.zeros((9, 9))
        q[:7, :7] = p["q"][t]
        q[7:, 7:] = np.diag(p["r"])
        gradient = np.r_[-p["q"][t] @ p["reference"][t], 0.0, 0.0]
        low, high = p["soft_lower"][t], p["soft_upper"][t]
        price = p["penalty"][[*order, 2]]
        out += [
            a.T, b.T, offset, np.diag(p["r_d"]), p["du_min"][t], p["du_max"][t], q, gradient,
            np.r_[low[order], p["u_min"][t]], np.r_[high[order], p["u_max"][t]],
            np.r_[p["soft_normal"][t, 2], 0.0, 0.0], np.array([low[2], high[2]]),
            price[:, 0], price[:, 1],
        ]  # fmt: skip
    return b"".join(np.ascontiguousarray(part, dtype=np.float64).tobytes() for part in out)


class Clarabel(Ours):
    """Clarabel as the fallback solver uses it: updated in place, without equilibration."""

    def __init__(self, repeats: int) -> None:
        super().__init__(repeats, "clarabel")


# Name, package, whether it has a warm start.
RIVALS: dict[type[Rival], tuple[str, str, bool]] = {
    Ours: ("ours", "egp_service", True),
    Clarabel: ("Clarabel", "egp_service", False),
    Piqp: ("PIQP", "piqp", False),
    Daqp: ("DAQP", "daqp", True),
    Osqp: ("OSQP", "osqp", True),
    ProxQp: ("ProxQP", "proxsuite", True),
}
