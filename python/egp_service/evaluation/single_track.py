"""Baselines without learning: a kinematic and a dynamic single-track vehicle.

Both predict the change of `[v_x, v_y, omega]` over one period from
`z = [v_x, v_y, omega, delta, F_x, delta_dot]`, as a member does, so that they can replace a member
in the same optimal control problem. Equations: Rajamani, *Vehicle Dynamics and Control*, 2nd ed.,
sections 2.2 and 2.3; Althoff, Koschi and Manzinger, *CommonRoad: vehicle models* (2017),
sections 5 and 7.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from egp_service._core import GRAVITY
from egp_service.quantities import NY, NZ

if TYPE_CHECKING:
    from numpy.typing import NDArray

# The middle of the roads' frictions, the best choice without adaptation.
NOMINAL_FRICTION: Final = 0.8
_SLOWEST: Final = 1.0  # m/s; slip angles are computed with at least this speed
_SUBSTEP: Final = 0.02  # s, of the Runge-Kutta integration
# Steps of the central differences, whose errors are then about 1e-9.
_STEPS: Final = np.array([1e-4, 1e-4, 1e-5, 1e-5, 1.0, 1e-5])


@dataclasses.dataclass(frozen=True)
class Chassis:
    """Mass and geometry as published with CommonRoad."""

    mass: float
    """Mass, kg."""
    yaw_inertia: float
    """Yaw inertia, kg m²."""
    front: float
    """Distance from the centre of mass to the front axle, m."""
    rear: float
    """Distance from the centre of mass to the rear axle, m."""
    height: float
    """Height of the centre of mass, m."""


CHASSIS: Final = {
    1: Chassis(1225.887, 1538.853371, 0.88392, 1.50876, 0.557784),
    2: Chassis(1093.2952, 1791.599521, 1.1561957064, 1.4227170936, 0.574),
}


class Prediction(Protocol):
    """Predicts the change of `[v_x, v_y, omega]`, (n, 3), at inputs z (n, 6)."""

    def __call__(self, z: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
        """Predict over `dt` seconds."""


@dataclasses.dataclass(frozen=True)
class Kinematic:
    """A kinematic single-track vehicle: wheels roll without slip, so friction has no effect."""

    chassis: Chassis

    def __call__(self, z: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
        """Predict over `dt` seconds."""
        v_x, v_y, omega, delta, force, delta_dot = z.T
        v_after = v_x + dt * force / self.chassis.mass
        omega_after = (
            v_after * np.tan(delta + dt * delta_dot) / (self.chassis.front + self.chassis.rear)
        )
        v_y_after = self.chassis.rear * omega_after
        return np.column_stack([v_after - v_x, v_y_after - v_y, omega_after - omega])


@dataclasses.dataclass(frozen=True)
class SingleTrack:
    """A single-track vehicle with load transfer and tyre forces saturated at a nominal friction.

    `F_y = mu F_z sin(C atan(B alpha))` with `B C` the cornering stiffness per load.
    """

    chassis: Chassis
    friction: float = NOMINAL_FRICTION
    stiffness: float = 20.898
    """Cornering stiffness over load, 1/rad, of CommonRoad's single-track vehicle."""
    shape: float = 1.5
    """C; beyond its peak the force decreases as that of the simulated tyres does."""

    def __call__(self, z: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
        """Predict over `dt` seconds by Runge-Kutta of order 4."""
        count = max(1, round(dt / _SUBSTEP))
        h = dt / count
        motion, (delta, force, delta_dot) = z[:, :NY].T, z[:, NY:].T
        start = motion
        for k in range(count):
            at = delta + k * h * delta_dot

            def rate(
                motion: NDArray[np.float64], t: float, at: NDArray[np.float64] = at
            ) -> NDArray[np.float64]:
                return self._rate(motion, at + t * delta_dot, force)

            a = rate(motion, 0.0)
            b = rate(motion + 0.5 * h * a, 0.5 * h)
            c = rate(motion + 0.5 * h * b, 0.5 * h)
            d = rate(motion + h * c, h)
            motion = motion + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        return (motion - start).T

    def _rate(
        self, motion: NDArray[np.float64], delta: NDArray[np.float64], force: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Time derivative of `[v_x, v_y, omega]`, (3, n)."""
        car = self.chassis
        v_x, v_y, omega = motion
        v = np.maximum(v_x, _SLOWEST)
        a_x = force / car.mass
        wheelbase = car.front + car.rear
        load_front = car.mass * (GRAVITY * car.rear - a_x * car.height) / wheelbase
        load_rear = car.mass * (GRAVITY * car.front + a_x * car.height) / wheelbase
        lateral_front = self._tyre(delta - np.arctan2(v_y + car.front * omega, v), load_front)
        lateral_rear = self._tyre(-np.arctan2(v_y - car.rear * omega, v), load_rear)
        across = lateral_front * np.cos(delta)
        return np.array(
            [
                a_x - lateral_front * np.sin(delta) / car.mass + v_y * omega,
                (across + lateral_rear) / car.mass - v_x * omega,
                (car.front * across - car.rear * lateral_rear) / car.yaw_inertia,
            ]
        )

    def _tyre(self, slip: NDArray[np.float64], load: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lateral force of an axle, N."""
        factor = self.stiffness / (self.shape * self.friction)
        return self.friction * load * np.sin(self.shape * np.arctan(factor * slip))


def linearise(
    prediction: Prediction, z: NDArray[np.float64], dt: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Predictions (n, 3) and their Jacobians (n, 3, 6) by central differences."""
    n = len(z)
    shifts = np.vstack([np.zeros(NZ), np.diag(_STEPS), -np.diag(_STEPS)])
    shifted = prediction((z[None] + shifts[:, None]).reshape(-1, NZ), dt).reshape(
        len(shifts), n, NY
    )
    jacobian = (shifted[1 : NZ + 1] - shifted[NZ + 1 :]) / (2.0 * _STEPS[:, None, None])
    return shifted[0], jacobian.transpose(1, 2, 0)
