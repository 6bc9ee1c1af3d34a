"""The prior mean of a member: a single-track vehicle fitted to its surface.

Far from its data a GP returns to its prior mean. A constant mean predicts no slide for a car that
brakes harder or drives faster than the data; this vehicle does. The equations are those of
`SingleTrack` in `rust/core/src/vehicle`, written in torch so that GPyTorch's predictions and
Jacobians include them. `vehicle_fit` determines the parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch

from egp_service._core import FULL_SIZE, GRAVITY, MIN_SLIP_SPEED
from egp_service.quantities import NY

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def change(z: torch.Tensor, parameters: torch.Tensor, dt: float, steps: int) -> torch.Tensor:
    """Change of `[v_x, v_y, omega]` (n, 3) over `dt` at inputs z (n, 6).

    The parameters (17,) or, with a resistance, (19,) are common to all inputs, or each input has
    its own (n, 17) or (n, 19).

    These are `steps` explicit Euler steps with the steering angle in the middle of each, by the
    equations of `SingleTrack` in Rust.
    """
    step = dt / steps
    total = _euler_step(z, parameters, step)
    for done in range(1, steps):
        steering = z[..., 3] + done * step * z[..., 5]
        after = torch.cat([z[..., :3] + total, steering[..., None], z[..., 4:]], dim=-1)
        total = total + _euler_step(after, parameters, step)
    return total


def _euler_step(z: torch.Tensor, parameters: torch.Tensor, dt: float) -> torch.Tensor:
    """Return the change (n, 3) over one step of `dt` s."""
    v_x, v_y, omega, delta, force, delta_dot = z.unbind(-1)
    mass, l_f, l_r, gyration, height, drive, brake, *rest = parameters.unbind(-1)
    tyres, resistance = rest[:10], rest[10:]
    steering = delta + 0.5 * dt * delta_dot
    a = force / mass
    driven = force > 0.0
    a_x = a / (1.0 + (a / (GRAVITY * torch.where(driven, drive, brake))) ** 4) ** 0.25
    # As the function `slip_speed` of the extension, with a derivative.
    slowest = MIN_SLIP_SPEED * torch.sqrt(((l_f + l_r) / FULL_SIZE).clamp(max=1.0))
    v = torch.maximum(v_x, slowest)

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
    ahead = a_x - front * torch.sin(steering) + v_y * omega
    if resistance:
        rolling, drag = resistance
        ahead = ahead - rolling * (v_x / slowest).clamp(-1.0, 1.0) - drag * v_x * v_x.abs()
    rate = [
        ahead,
        across + rear - v_x * omega,
        (l_f * across - l_r * rear) / gyration,
    ]
    return dt * torch.stack(rate, dim=-1)


def kinematic_change(z: torch.Tensor, parameters: torch.Tensor, dt: float) -> torch.Tensor:
    """Change of `[v_x, v_y, omega]` (n, 3) of a vehicle whose wheels roll without slip.

    The parameters (3,) are mass in kg and the axle distances in m; the equations are those of
    `Kinematic` in Rust.
    """
    v_x, v_y, omega, delta, force, delta_dot = z.unbind(-1)
    mass, l_f, l_r = parameters.unbind()
    gain = dt * force / mass
    after = (v_x + gain) * torch.tan(delta + dt * delta_dot) / (l_f + l_r)
    return torch.stack([gain, l_r * after - v_y, after - omega], dim=-1)


class PriorMean(NamedTuple):
    """What a member's processes are added to: one vehicle, or zero."""

    single_track: NDArray[np.float64] | None = None
    """Parameters (17,), or (19,) with a resistance, of a single-track vehicle."""
    steps: int = 1
    """Number of Euler steps in a period of the single-track vehicle."""
    kinematic: NDArray[np.float64] | None = None
    """Parameters (3,) of a kinematic vehicle."""
    constant: bool = True
    """Whether a constant is added, which is fitted to the data."""

    def change(self, z: torch.Tensor, dt: float) -> torch.Tensor:
        """Change (n, 3) at inputs (n, 6), without the constant."""
        if self.single_track is not None:
            return change(z, z.new_tensor(self.single_track), dt, self.steps)
        if self.kinematic is not None:
            return kinematic_change(z, z.new_tensor(self.kinematic), dt)
        return z.new_zeros((len(z), NY))

    def predict(self, z: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
        """Return `change` for an array."""
        return self.change(torch.from_numpy(z), dt).numpy()
