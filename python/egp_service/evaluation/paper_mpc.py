"""The paper's optimal control problem, eq. (18), as a DPP-parametrised CVXPY problem for OSQP.

Its weights, limits and penalties are those of this system's step, so that both do the same work.
As in the paper there is no proximal term, no factor of the terminal weight for slippery roads, and
no bound of the force by tyres, bends and the reference speed, so that plans differ. For the
conditioning of OSQP, states are deviations from the reference and inputs are scaled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cvxpy as cp
import numpy as np

from egp_service._core import MIN_SLIP_SPEED, EgpError
from egp_service.quantities import DELTA, NU, NX, OMEGA, PSI, V_X, V_Y

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class Mpc:
    """The problem, built once for a horizon and solved with new parameter values."""

    def __init__(self, horizon: int, dt: float, settings: dict[str, Any]) -> None:
        """Build the problem from the settings of this system's step."""
        self.horizon, self.settings = horizon, settings
        cost, limits, soft = settings["cost"], settings["limits"], settings["soft"]
        self.a = [cp.Parameter((NX, NX)) for _ in range(horizon)]
        self.b = [cp.Parameter((NX, NU)) for _ in range(horizon)]
        self.d = cp.Parameter((horizon, NX))
        self.root_q = [cp.Parameter((4, 4)) for _ in range(horizon)]
        self.e0, self.u_prev = cp.Parameter(NX), cp.Parameter(NU)
        self.reference_v = cp.Parameter(horizon)
        self.drive = cp.Parameter(horizon)
        self.steering = cp.Parameter((horizon, 2))
        self.normal = cp.Parameter((horizon, 2))
        self.edges = cp.Parameter((horizon, 2), nonneg=True)
        self.e, self.u = cp.Variable((horizon + 1, NX)), cp.Variable((horizon, NU))
        slack = cp.Variable((horizon, 3), nonneg=True)

        slew = np.array([limits["a_slew"], limits["delta_dot_slew"]]) * dt
        low = np.array([limits["a_min"], -limits["delta_dot"]])
        rate = cp.vstack([self.u[0] - self.u_prev, self.u[1:] - self.u[:-1]])
        lateral = cp.sum(cp.multiply(self.normal, self.e[1:, :2]), axis=1)
        constraints = [
            self.e[0] == self.e0,
            self.u[:, 0] <= self.drive,
            self.u[:, 1] <= limits["delta_dot"],
            self.u >= np.tile(low, (horizon, 1)),
            cp.abs(rate) <= np.tile(slew, (horizon, 1)),
            self.e[1:, V_X] + self.reference_v <= soft["v_x_max"] + slack[:, 0],
            self.e[1:, V_X] + self.reference_v >= -slack[:, 0],
            self.e[1:, DELTA] >= self.steering[:, 0] - slack[:, 1],
            self.e[1:, DELTA] <= self.steering[:, 1] + slack[:, 1],
            lateral <= self.edges[:, 0] + slack[:, 2],
            lateral >= -self.edges[:, 1] - slack[:, 2],
        ]
        objective = 0.0
        for t in range(horizon):
            constraints.append(
                self.e[t + 1] == self.a[t] @ self.e[t] + self.b[t] @ self.u[t] + self.d[t]
            )
            objective += 0.5 * cp.sum_squares(self.root_q[t] @ self.e[t + 1, :4])
        for i in range(NU):
            objective += 0.5 * cost["input"][i] * cp.sum_squares(self.u[:, i])
            objective += 0.5 * cost["rate"][i] * cp.sum_squares(rate[:, i])
        for j, name in enumerate(("speed", "steering", "track")):
            objective += soft[name]["linear"] * cp.sum(slack[:, j])
            objective += 0.5 * soft[name]["quadratic"] * cp.sum_squares(slack[:, j])
        self.problem = cp.Problem(cp.Minimize(objective), constraints)

    def solve(
        self,
        dynamics: tuple[Array, Array, Array],
        *,
        x0: Array,
        u_prev: Array,
        reference: Array,
        edges: Array,
        operating: Array,
        slip: float,
    ) -> tuple[Array, Array]:
        """Plan `(T+1, 7)` and scaled inputs `(T, 2)`.

        Dynamics are `A (T, 7, 7)`, `B (T, 7, 2)` for scaled inputs and `c (T, 7)` along the
        operating states `(T+1, 7)`, `slip` the largest slip angle of the front tyres, rad.

        Raises:
            EgpError: if OSQP finds no plan.

        """
        cost, limits, soft = (self.settings[name] for name in ("cost", "limits", "soft"))
        a, b, c = dynamics
        r = np.zeros((self.horizon + 1, NX))
        r[:, :4] = reference
        for t in range(self.horizon):
            self.a[t].value, self.b[t].value = a[t], b[t]
            factor = cost["terminal"] if t + 1 == self.horizon else 1.0
            sin, cos = np.sin(reference[t + 1, PSI]), np.cos(reference[t + 1, PSI])
            root = np.diag(
                np.sqrt(
                    factor
                    * np.array([cost["longitudinal"], cost["lateral"], cost["v_x"], cost["psi"]])
                )
            )
            root[:2, :2] = root[:2, :2] @ np.array([[cos, sin], [-sin, cos]])
            self.root_q[t].value = root
        self.d.value = np.einsum("tij,tj->ti", a, r[:-1]) + c - r[1:]
        self.e0.value, self.u_prev.value = x0 - r[0], u_prev
        self.reference_v.value = r[1:, V_X]
        self.drive.value = np.minimum(limits["a_max"], limits["power"] / operating[:-1, V_X])
        sideways = operating[1:, V_Y] + soft["front"] * operating[1:, OMEGA]
        moving = operating[1:, V_X] >= MIN_SLIP_SPEED
        direction = np.arctan(sideways / np.maximum(operating[1:, V_X], MIN_SLIP_SPEED))
        allowed = np.where(moving, slip, np.inf)[:, None] * np.array([-1.0, 1.0])
        self.steering.value = np.clip(direction[:, None] + allowed, -soft["delta"], soft["delta"])
        self.normal.value = np.stack([-np.sin(reference[1:, PSI]), np.cos(reference[1:, PSI])], -1)
        self.edges.value = edges
        self.problem.solve(solver=cp.OSQP, warm_start=True, ignore_dpp=False)
        if self.e.value is None:
            raise EgpError(f"OSQP found no plan for the paper's problem: {self.problem.status}")
        return np.asarray(self.e.value) + r, np.asarray(self.u.value)
