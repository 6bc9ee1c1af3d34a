"""The number of Euler steps with which a single-track vehicle is stable.

The explicit Euler method multiplies a motion of rate `r` (1/s) by `1 - h r` in a step of `h` s, so
that it is unstable where `h r` exceeds 2. The lateral motion of a slow vehicle is that fast.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import GRAVITY, slip_speed

if TYPE_CHECKING:
    from numpy.typing import NDArray

_LARGEST_STEP: Final = 1.8  # times the fastest rate
# Larger rates, 1/s, are those of no car: they come from fits to noise. The simulated car has 82/s.
_FASTEST: Final = 500.0
_MOST_STEPS: Final = 100  # that a library may state


def euler_steps(parameters: NDArray[np.float64], dt: float) -> int:
    """Return the number of explicit Euler steps with which a vehicle is stable over `dt` s.

    The parameters are (17,) or (19,). The lateral motion is fastest at the lowest speed of slip
    angles (`slip_speed`): straight on, with the cornering stiffnesses `c_f` and `c_r` over the
    mass, it is `d[v_y, omega]/dt = A [v_y, omega]` (Rajamani, *Vehicle Dynamics and Control*,
    section 2.3). A step times the largest eigenvalue of `A` is at most 1.8. The simulated car needs
    a second step from 22 ms on. Eigenvalues above 500/s, which no car has, count as 500/s, and
    there are at most 100 steps, so that a vehicle fitted to noise may be unstable.
    """
    _, l_f, l_r, gyration, *rest = parameters
    tyres, v = rest[3:], slip_speed(l_f + l_r)
    c_f = GRAVITY * l_r / (l_f + l_r) * float(np.prod(tyres[2:5]))
    c_r = GRAVITY * l_f / (l_f + l_r) * float(np.prod(tyres[7:10]))
    turning = (l_f * c_f - l_r * c_r) / v
    A = np.array(
        [
            [-(c_f + c_r) / v, -turning - v],
            [-turning / gyration, -(l_f**2 * c_f + l_r**2 * c_r) / (v * gyration)],
        ]
    )
    fastest = min(float(np.abs(np.linalg.eigvals(A)).max()), _FASTEST)
    return min(math.ceil(dt * fastest / _LARGEST_STEP), _MOST_STEPS)
