"""The vehicle's quantities: names, units, and columns of states, inputs, GP inputs and GP outputs.

The order is that of the paper and of `egp-core`; `NOTATION.md` there gives the symbols. The names
are those of a dataset's columns. The keys of each mapping are names, its values SI units.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

STATE: Final = {
    "p_x": "m",
    "p_y": "m",
    "v_x": "m/s",
    "psi": "rad",
    "v_y": "m/s",
    "omega": "rad/s",
    "delta": "rad",
}
"""State x of the vehicle. A row of a reference trajectory holds its first four quantities."""
INPUT: Final = {"F_x": "N", "delta_dot": "rad/s"}
"""Input u of the vehicle."""
P_X, P_Y, V_X, PSI, V_Y, OMEGA, DELTA = range(len(STATE))
F_X, DELTA_DOT = range(len(INPUT))
POSITION: Final = [P_X, P_Y]
MOTION: Final = [V_X, V_Y, OMEGA]
"""Columns of the state whose changes over a control period a GP predicts."""
GP_STATE: Final = [*MOTION, DELTA]
"""Columns of the state that a GP's input begins with; the vehicle's input follows."""

GP_STATE_NAMES: Final = tuple(list(STATE)[column] for column in GP_STATE)
GP_INPUT: Final = {name: STATE[name] for name in GP_STATE_NAMES} | INPUT
"""Input z of a GP; its first `NY` quantities are those whose changes are the outputs."""
GP_OUTPUT: Final = {"d_v_x": "m/s", "d_v_y": "m/s", "d_omega": "rad/s"}
"""Output y of a GP: the changes of `v_x`, `v_y` and `omega` over one control period."""
TILT: Final = {"grade": "rad", "bank": "rad"}
"""Tilt of a road: positive uphill, and positive where the left side is the higher one."""
MOTION_LABELS: Final = ("v_x, m/s", "v_y, m/s", "ω, rad/s")
"""Labels of the columns `MOTION` in figures and tables."""
NORMAL_95: Final = 1.959963984540054
"""Half the width of a normal distribution's two-sided 95 % interval, in standard deviations."""
NX: Final = len(STATE)
NU: Final = len(INPUT)
NZ: Final = len(GP_INPUT)
NY: Final = len(GP_OUTPUT)


def gp_input(x: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
    """GP inputs z (..., 6) of states x (..., 7) and inputs u (..., 2)."""
    return np.concatenate([x[..., GP_STATE], u], axis=-1)
