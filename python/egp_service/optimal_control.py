"""The parts of the control step by themselves: the optimal control problem, weights and residual.

`solve_ocp` solves eq. (18) around given linear dynamics, `solve_weights` eq. (6) for given
predictions, and `predict_residual` estimates what no member predicts; all are what the control
step runs. `Controller.problem` returns the problem of a step. The docstrings give equations, shapes
and units.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from egp_service._core import (
    OcpBounds,
    OcpMultipliers,
    OcpResult,
    OcpWeights,
    ocp_to_qp,
    predict_residual,
    solve_ocp,
    solve_weights,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = [
    "OcpBounds",
    "OcpMultipliers",
    "OcpProblem",
    "OcpResult",
    "OcpWeights",
    "ocp_to_qp",
    "predict_residual",
    "solve_ocp",
    "solve_weights",
]


class OcpProblem(NamedTuple):
    """The optimal control problem of a control step: the arguments of `solve_ocp`, in their order.

    The dynamics are x_{t+1} = A_t x_t + B_t u_t + c_t for t = 0..T-1, the states
    `[p_x, p_y, v_x, psi, v_y, omega, delta]` in SI units and rad, and the inputs acceleration and
    steering rate. Position and yaw are relative to the measured pose, which is zero in `x0`.
    """

    A: NDArray[np.float64]
    """Derivatives of the next state by the state (T, 7, 7)."""
    B: NDArray[np.float64]
    """Derivatives of the next state by the input (T, 7, 2)."""
    c: NDArray[np.float64]
    """Constant parts of the dynamics (T, 7)."""
    x0: NDArray[np.float64]
    """State (7,) at which the plan starts."""
    u_prev: NDArray[np.float64]
    """Acceleration in m/s² and steering rate in rad/s (2,) that are applied now."""
    reference: NDArray[np.float64]
    """Reference (T, 7) of x_1..x_T, in the units of the states."""
    weights: OcpWeights
    """Weights of the cost."""
    bounds: OcpBounds
    """Bounds of inputs and states, and their penalties."""
