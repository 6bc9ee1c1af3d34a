"""The parts of the control step by themselves: the optimal control problem, weights and residual.

`solve_ocp` solves eq. (18) around given linear dynamics, `solve_weights` eq. (6) for given
predictions, and `predict_residual` estimates what no member predicts; all are what the control
step runs. Their docstrings give equations, shapes and units.
"""

from egp_service._core import (
    OcpBounds,
    OcpResult,
    OcpWeights,
    predict_residual,
    solve_ocp,
    solve_weights,
)

__all__ = [
    "OcpBounds",
    "OcpResult",
    "OcpWeights",
    "predict_residual",
    "solve_ocp",
    "solve_weights",
]
