"""The prior mean of a member: a single-track vehicle fitted to its surface.

Far from its data a GP returns to its prior mean. A constant mean predicts no slide for a car that
brakes harder or drives faster than the data; this vehicle does. The equations are those of
`SingleTrack` in `rust/core/src/vehicle`, written in torch so that GPyTorch's predictions and
Jacobians include them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import torch
from scipy.optimize import least_squares

from egp_service._core import GRAVITY, EgpError

if TYPE_CHECKING:
    from numpy.typing import NDArray

SLOWEST: Final = 3.0  # m/s; slip angles are computed with at least this speed
# Start and bounds of the fit: small cars to vans, tyres from ice to racing. A shape above 2 would
# reverse the force at large slip, and with a shape below 1 the force would have no peak.
_PARAMETERS: Final = {
    "m": (1300.0, 300.0, 4000.0),
    "l_f": (1.2, 0.3, 3.0),
    "l_r": (1.4, 0.3, 3.0),
    "k²": (1.6, 0.2, 6.0),
    "h": (0.5, 0.1, 1.5),
    "D_d": (0.8, 0.02, 2.0),
    "D_b": (0.8, 0.02, 2.0),
    "e_df": (1.0, 0.1, 100.0),
    "e_bf": (1.0, 0.1, 100.0),
    "D_f": (0.8, 0.02, 2.0),
    "B_f": (20.0, 4.0, 80.0),
    "C_f": (1.4, 1.05, 1.9),
    "e_dr": (1.0, 0.1, 100.0),
    "e_br": (1.0, 0.1, 100.0),
    "D_r": (0.8, 0.02, 2.0),
    "B_r": (20.0, 4.0, 80.0),
    "C_r": (1.4, 1.05, 1.9),
}
_START, _LOWEST, _HIGHEST = (np.array(row) for row in zip(*_PARAMETERS.values(), strict=True))
_FIT_POINTS: Final = 8000
# Scale of the robust loss in standard deviations of the change. Larger residuals have a bounded
# influence: effects outside the model (a spin, a locked wheel) are left to the GPs.
_OUTLIER: Final = 0.1


def change(z: torch.Tensor, parameters: torch.Tensor, dt: float) -> torch.Tensor:
    """Change of `[v_x, v_y, omega]` (n, 3) over `dt` at inputs z (n, 6); parameters (17,).

    This is one explicit Euler step with the steering angle in the middle of the period, by the
    equations of `SingleTrack` in Rust.
    """
    v_x, v_y, omega, delta, force, delta_dot = z.unbind(-1)
    mass, l_f, l_r, gyration, height, drive, brake, *tyres = parameters.unbind()
    steering = delta + 0.5 * dt * delta_dot
    a = force / mass
    driven = force > 0.0
    a_x = a / (1.0 + (a / (GRAVITY * torch.where(driven, drive, brake))) ** 4) ** 0.25
    v = v_x.clamp(min=SLOWEST)

    def lateral(
        position: torch.Tensor, steered: torch.Tensor | float, load: torch.Tensor, axle: int
    ) -> torch.Tensor:
        under_drive, under_brake, friction, stiffness, shape = tyres[5 * axle : 5 * axle + 5]
        coupling = torch.where(driven, under_drive, under_brake)
        left = 1.0 / torch.sqrt(1.0 + (coupling * a / GRAVITY) ** 4)
        slip = steered - torch.atan((v_y + position * omega) / v)
        return load * friction * left * torch.sin(shape * torch.atan(stiffness * slip))

    wheelbase = l_f + l_r
    front = lateral(l_f, steering, (GRAVITY * l_r - height * a_x) / wheelbase, 0)
    rear = lateral(-l_r, 0.0, (GRAVITY * l_f + height * a_x) / wheelbase, 1)
    across = front * torch.cos(steering)
    rate = [
        a_x - front * torch.sin(steering) + v_y * omega,
        across + rear - v_x * omega,
        (l_f * across - l_r * rear) / gyration,
    ]
    return dt * torch.stack(rate, dim=-1)


def predict(
    z: NDArray[np.float64], parameters: NDArray[np.float64], dt: float
) -> NDArray[np.float64]:
    """Return `change` for arrays."""
    return change(torch.from_numpy(z), torch.from_numpy(parameters), dt).numpy()


def fit(
    z: NDArray[np.float64], y: NDArray[np.float64], dt: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Fit the parameters (17,) to changes y (n, 3) at inputs z (n, 6) by robust least squares.

    Raises:
        EgpError: if the fit does not converge.

    """
    rows = rng.permutation(len(z))[:_FIT_POINTS]
    scale = _OUTLIER * y.std(axis=0)

    def residuals(logarithm: NDArray[np.float64]) -> NDArray[np.float64]:
        predicted = predict(z[rows], _START * np.exp(logarithm), dt)
        return np.asarray(((predicted - y[rows]) / scale).ravel())

    bounds = np.log(_LOWEST / _START), np.log(_HIGHEST / _START)
    found = least_squares(residuals, np.zeros(len(_START)), loss="soft_l1", bounds=bounds)
    if not (found.success and np.isfinite(found.cost)):
        raise EgpError(
            f"no single-track vehicle fits the data ({found.message}): "
            'check their units, or train with mean = "constant"'
        )
    return np.asarray(_START * np.exp(found.x))
