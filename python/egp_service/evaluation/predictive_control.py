"""The optimal control problem of the control step with dynamics from any prediction.

Cost, bounds, solver, warm start and gate are those of `Controller`; only the dynamics differ. Tests
verify that the plans agree with those of the service if a member is the prediction.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from egp_service._core import AffineOcp, Gate
from egp_service.control.step import Step, Timings
from egp_service.control.toml_text import dumps
from egp_service.quantities import (
    DELTA,
    DELTA_DOT,
    F_X,
    GP_STATE,
    MOTION,
    NU,
    NX,
    NY,
    NZ,
    OMEGA,
    P_X,
    P_Y,
    POSITION,
    PSI,
    V_X,
    V_Y,
    gp_input,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from egp_service._core import VehicleParameters


class PredictiveController:
    """A controller with the dynamics `linearise(z) -> (change (n, 3), Jacobian (n, 3, 6))`.

    `settings` are all settings of a control step (`Controller.settings`), `friction` the assumed
    friction coefficient of the surface.
    """

    library = b""
    members: Sequence[str] = ()

    def __init__(
        self,
        linearise: Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]],
        settings: Mapping[str, object],
        dt: float,
        *,
        vehicle: VehicleParameters,
        mass: float,
        friction: float,
        gate: Mapping[str, float],
    ) -> None:
        """Start without a plan."""
        self._linearise = linearise
        self._settings: dict[str, Any] = {**settings, "mass": mass}
        self._yaw_at = float(self._settings["operating"]["yaw_at"])
        self._ocp = AffineOcp(dumps(self._settings), vehicle, dt, friction)
        self.dt = dt
        self.horizon = int(self._settings["horizon"])
        self._gate = Gate(dt, dict(gate))
        self._tick = 0
        self._u = np.zeros(NU)
        self._plan: tuple[NDArray[np.float64], NDArray[np.float64], int] | None = None

    def step(
        self,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        *,
        deadline: float | None = None,
    ) -> Step:
        """Return the command for a measured state (7,), reference (T+1, 4) and widths (T+1, 2)."""
        del deadline  # a step in this process has no deadline
        start = time.perf_counter()
        state = np.asarray(x, dtype=np.float64)
        rows = np.asarray(reference, dtype=np.float64)
        self._tick += 1
        x0, local = state.copy(), rows.copy()
        x0[POSITION] = 0.0
        local[:, POSITION] -= state[POSITION]
        local[:, PSI] = np.unwrap(np.concatenate([[state[PSI]], rows[:, PSI]]))[1:]
        edges = None if widths is None else np.ascontiguousarray(widths, dtype=np.float64)
        operating = self._dynamics(x0, state[POSITION])
        solution = self._ocp.solve(x0, self._u, *operating, local, edges)
        status = solution.status
        solved = status == "solved"
        plan_x, plan_u = solution.x, solution.u * (self._settings["mass"], 1.0)
        if solved:
            plan_x[:, POSITION] += state[POSITION]
            self._plan = (plan_x, plan_u, self._tick)
            if self._gate.mode != "stop":
                self._gate.accept(self._tick, plan_u)
        command = self._gate.command(self._tick, float(state[V_X]), float(state[DELTA]))
        self._u = np.array(command.u)
        return Step(
            u=self._u,
            mode=command.mode,
            limited=command.limited,
            status=status,
            detail="",
            weights=np.empty(0),
            plan_x=plan_x if solved else None,
            plan_u=plan_u if solved else None,
            sigma=None,
            timings=Timings(time.perf_counter() - start),
            replica="in-process",
            request=b"",
            reply=None,
            late=(),
        )

    def _guess(self, x0: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return states (at most T+1) and inputs (T, 2) of the rest of the last plan."""
        u = np.zeros((self.horizon, NU))
        shift = self.horizon if self._plan is None else self._tick - self._plan[2]
        if self._plan is None or shift >= self.horizon:
            return x0[None], u
        plan_x, plan_u, _ = self._plan
        u[: self.horizon - shift] = plan_u[shift:]
        u[self.horizon - shift :, F_X] = plan_u[-1, F_X]
        return plan_x[shift:], u

    def _dynamics(
        self, x0: NDArray[np.float64], origin: NDArray[np.float64]
    ) -> tuple[
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
    ]:
        """Operating states (T+1, 7), inputs (T, 2), and `A`, `B`, `c` along them, in SI units."""
        guess_x, u = self._guess(x0 + np.concatenate([origin, np.zeros(5)]))
        guess_x = guess_x - np.concatenate([origin, np.zeros(5)])
        x = np.empty((self.horizon + 1, NX))
        x[0] = self._inside(x0)
        known = min(len(guess_x), self.horizon + 1)
        x[1:known] = self._inside(guess_x[1:known])
        change = np.empty((self.horizon, NY))
        jacobian = np.empty((self.horizon, NY, NZ))
        together = min(known, self.horizon)
        change[:together], jacobian[:together] = self._predict(x[:together], u[:together])
        for t in range(known - 1, self.horizon):
            change[t : t + 1], jacobian[t : t + 1] = self._predict(x[t : t + 1], u[t : t + 1])
            x[t + 1] = self._inside(
                _successor(x[t : t + 1], u[t : t + 1], change[t], self.dt, self._yaw_at)[0]
            )
        A, B = _jacobians(x[:-1], jacobian, self.dt, self._yaw_at)
        following = _successor(x[:-1], u, change, self.dt, self._yaw_at)
        c = following - np.einsum("tij,tj->ti", A, x[:-1]) - np.einsum("tij,tj->ti", B, u)
        return x, u, A, B, c

    def _predict(
        self, x: NDArray[np.float64], u: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self._linearise(np.ascontiguousarray(gp_input(x, u)))

    def _inside(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Clamp to the operating box; positions and yaw are free."""
        box = self._settings["operating"]
        high = np.full(NX, np.inf)
        high[V_X:] = (
            max(self._settings["soft"]["v_x_max"], box["v_x_min"]),
            np.inf,
            box["v_y"],
            box["omega"],
            self._settings["soft"]["delta"],
        )
        low = -high
        low[V_X] = box["v_x_min"]
        return np.clip(x, low, high)


def _successor(
    x: NDArray[np.float64],
    u: NDArray[np.float64],
    change: NDArray[np.float64],
    dt: float,
    yaw_at: float,
) -> NDArray[np.float64]:
    """Next states (n, 7), eqs. (10)-(11) along the yaw at `yaw_at` of the period."""
    yaw = x[:, PSI] + yaw_at * dt * x[:, OMEGA]
    cos, sin = np.cos(yaw), np.sin(yaw)
    following = x.copy()
    following[:, P_X] += (x[:, V_X] * cos - x[:, V_Y] * sin) * dt
    following[:, P_Y] += (x[:, V_X] * sin + x[:, V_Y] * cos) * dt
    following[:, PSI] += x[:, OMEGA] * dt
    following[:, DELTA] += u[:, DELTA_DOT] * dt
    following[:, MOTION] += change
    return following


def _jacobians(
    x: NDArray[np.float64], jacobian: NDArray[np.float64], dt: float, yaw_at: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give `A` (n, 7, 7) and `B` (n, 7, 2), eqs. (15)-(17), of `_successor`."""
    yaw = x[:, PSI] + yaw_at * dt * x[:, OMEGA]
    cos, sin = np.cos(yaw), np.sin(yaw)
    A = np.tile(np.eye(NX), (len(x), 1, 1))
    B = np.zeros((len(x), NX, NU))
    A[:, P_X, V_X], A[:, P_X, V_Y] = cos * dt, -sin * dt
    A[:, P_X, PSI] = (-x[:, V_X] * sin - x[:, V_Y] * cos) * dt
    A[:, P_Y, V_X], A[:, P_Y, V_Y] = sin * dt, cos * dt
    A[:, P_Y, PSI] = (x[:, V_X] * cos - x[:, V_Y] * sin) * dt
    A[:, POSITION, OMEGA] = yaw_at * dt * A[:, POSITION, PSI]
    A[:, PSI, OMEGA] = dt
    B[:, DELTA, DELTA_DOT] = dt
    for row, output in enumerate(MOTION):
        A[:, output, GP_STATE] += jacobian[:, row, : len(GP_STATE)]
        B[:, output] = jacobian[:, row, len(GP_STATE) :]
    return A, B
