"""The control step's optimal control problem around any prediction.

The cost, bounds, solver, warm start and gate of `Controller`; only where the dynamics come from
differs. The tests hold it to that: with a member as its prediction it plans what the service plans.
"""

from __future__ import annotations

import time
import tomllib
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from egp_service._core import AffineOcp, Gate
from egp_service.stepper import Step, Timings
from egp_service.toml_text import dumps

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from egp_service._core import VehicleParameters

# Columns of the state.
_V_X, _PSI, _OMEGA, _DELTA = 2, 3, 5, 6
_MOTION: Final = (2, 4, 5)  # v_x, v_y, omega
_PREDICTED_FROM: Final = (2, 4, 5, 6)  # of the state; the inputs follow


class PredictiveController:
    """Drives with `linearise(z) -> (change (n, 3), Jacobian (n, 3, 6))` as its dynamics.

    `settings` is the full TOML of a control step (`Engine.settings_toml`), `friction` that of the
    surface which the driver thinks to be on.
    """

    library = b""
    members: Sequence[str] = ()

    def __init__(
        self,
        linearise: Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]],
        settings: str,
        dt: float,
        *,
        vehicle: VehicleParameters,
        mass: float,
        friction: float,
        gate: Mapping[str, float],
    ) -> None:
        """Start without a plan."""
        self._linearise = linearise
        self._settings: dict[str, Any] = tomllib.loads(settings)
        self._settings["mass"] = mass
        self._yaw_at = float(self._settings["operating"]["yaw_at"])
        self._ocp = AffineOcp(dumps(self._settings), vehicle, dt, friction)
        self.dt = dt
        self.horizon = int(self._settings["horizon"])
        self._gate = Gate(dt, dict(gate))
        self._tick = 0
        self._u = np.zeros(2)
        self._plan: tuple[NDArray[np.float64], NDArray[np.float64], int] | None = None

    def step(
        self,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        *,
        deadline: float | None = None,
    ) -> Step:
        """Give the command for a measured state (7,), a reference (T+1, 4) and widths (T+1, 2)."""
        del deadline  # in process: the answer comes when it is ready
        start = time.perf_counter()
        state = np.asarray(x, dtype=np.float64)
        rows = np.asarray(reference, dtype=np.float64)
        self._tick += 1
        x0, local = state.copy(), rows.copy()
        x0[:2] = 0.0
        local[:, :2] -= state[:2]
        local[:, 3] = np.unwrap(np.concatenate([state[3:4], rows[:, 3]]))[1:]
        edges = None if widths is None else np.ascontiguousarray(widths, dtype=np.float64)
        operating = self._dynamics(x0, state[:2])
        solution = self._ocp.solve(x0, self._u, *operating, local, edges)
        status = solution.status.replace(" ", "_")
        solved = status == "solved"
        plan_x, plan_u = solution.x, solution.u * (self._settings["mass"], 1.0)
        if solved:
            plan_x[:, :2] += state[:2]
            self._plan = (plan_x, plan_u, self._tick)
            if self._gate.mode != "stop":
                self._gate.accept(self._tick, plan_u)
        command = self._gate.command(self._tick, float(state[_V_X]), float(state[_DELTA]))
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
        """Give states (at most T+1) and inputs (T, 2) of the last plan from now on."""
        u = np.zeros((self.horizon, 2))
        shift = self.horizon if self._plan is None else self._tick - self._plan[2]
        if self._plan is None or shift >= self.horizon:
            return x0[None], u
        plan_x, plan_u, _ = self._plan
        u[: self.horizon - shift] = plan_u[shift:]
        u[self.horizon - shift :, 0] = plan_u[-1, 0]
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
        x = np.empty((self.horizon + 1, 7))
        x[0] = self._inside(x0)
        known = min(len(guess_x), self.horizon + 1)
        x[1:known] = self._inside(guess_x[1:known])
        change = np.empty((self.horizon, 3))
        jacobian = np.empty((self.horizon, 3, 6))
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
        return self._linearise(np.ascontiguousarray(np.hstack([x[:, _PREDICTED_FROM], u])))

    def _inside(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Clamp to the operating box; positions and yaw are free."""
        box = self._settings["operating"]
        high = np.full(7, np.inf)
        high[2:] = (
            max(self._settings["soft"]["v_x_max"], box["v_x_min"]),
            np.inf,
            box["v_y"],
            box["omega"],
            self._settings["soft"]["delta"],
        )
        low = -high
        low[_V_X] = box["v_x_min"]
        return np.clip(x, low, high)


def _successor(
    x: NDArray[np.float64],
    u: NDArray[np.float64],
    change: NDArray[np.float64],
    dt: float,
    yaw_at: float,
) -> NDArray[np.float64]:
    """Next states (n, 7), eqs. (10)-(11) along the yaw at `yaw_at` of the period."""
    yaw = x[:, _PSI] + yaw_at * dt * x[:, _OMEGA]
    cos, sin = np.cos(yaw), np.sin(yaw)
    following = x.copy()
    following[:, 0] += (x[:, 2] * cos - x[:, 4] * sin) * dt
    following[:, 1] += (x[:, 2] * sin + x[:, 4] * cos) * dt
    following[:, _PSI] += x[:, _OMEGA] * dt
    following[:, 6] += u[:, 1] * dt
    following[:, _MOTION] += change
    return following


def _jacobians(
    x: NDArray[np.float64], jacobian: NDArray[np.float64], dt: float, yaw_at: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give `A` (n, 7, 7) and `B` (n, 7, 2), eqs. (15)-(17), of `_successor`."""
    yaw = x[:, _PSI] + yaw_at * dt * x[:, _OMEGA]
    cos, sin = np.cos(yaw), np.sin(yaw)
    A = np.tile(np.eye(7), (len(x), 1, 1))
    B = np.zeros((len(x), 7, 2))
    A[:, 0, 2], A[:, 0, 4] = cos * dt, -sin * dt
    A[:, 0, 3] = (-x[:, 2] * sin - x[:, 4] * cos) * dt
    A[:, 1, 2], A[:, 1, 4] = sin * dt, cos * dt
    A[:, 1, 3] = (x[:, 2] * cos - x[:, 4] * sin) * dt
    A[:, :2, _OMEGA] = yaw_at * dt * A[:, :2, 3]
    A[:, _PSI, _OMEGA] = dt
    B[:, 6, 1] = dt
    for row, output in enumerate(_MOTION):
        A[:, output, _PREDICTED_FROM] += jacobian[:, row, :4]
        B[:, output] = jacobian[:, row, 4:]
    return A, B
