"""A driver for data collection that follows a reference up to the tyres' limit.

Steering is pure pursuit with yaw-rate feedback, speed control is feed-forward plus proportional,
and both inputs have coloured noise. The driver uses the friction for the range of accelerations
only, and loses control beyond the limit, which the data should contain.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.data.experiment import largest_demand
from egp_service.quantities import P_X, P_Y, V_X

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service._core import VehicleParameters

_PREVIEW: Final = 0.5  # s, preview time of pure pursuit
_MAX_STEERING: Final = 0.45  # rad; larger angles only increase the slip of the front wheels
UNDERSTEER: Final = 0.0035
"""Extra steering angle per lateral acceleration, rad s²/m."""
_YAW_GAIN: Final = 0.15  # s, steering per yaw-rate error
_STEERING_TIME: Final = 0.1  # s, time constant of the steering control
_SPEED_TIME: Final = 0.5  # s, time constant of the speed control
_A_TIME: Final = 0.4  # s, correlation time of the noise on acceleration
_DELTA_DOT_TIME: Final = 0.15  # s, correlation time of the noise on steering rate


@dataclasses.dataclass
class Driver:
    """The driver of one vehicle, with its last input and the state of its noise.

    `mass` is the simulated vehicle's to the last digit, `vehicle` holds its actuators' limits.
    `noise` scales the excitation: at 1 the standard deviations are 2 m/s², or half of what the
    friction `mu` allows, and 0.15 rad/s.
    """

    rng: np.random.Generator
    dt: float
    mass: float
    vehicle: VehicleParameters
    noise: float
    mu: float
    wheelbase: float
    _a: float = 0.0
    _delta_dot: float = 0.0
    _noise: tuple[float, float] = (0.0, 0.0)

    def input(self, x: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return `[F_x, delta_dot]` at state (7,) for reference rows `[p_x, p_y, v_x, psi]`."""
        p_x, p_y, v_x, psi, _, omega, delta = x.tolist()
        aim = reference[min(len(reference) - 1, max(1, round(_PREVIEW / self.dt)))]
        ahead = math.cos(psi) * (aim[P_X] - p_x) + math.sin(psi) * (aim[P_Y] - p_y)
        left = -math.sin(psi) * (aim[P_X] - p_x) + math.cos(psi) * (aim[P_Y] - p_y)
        curvature = 2.0 * left / max(ahead * ahead + left * left, 1.0)
        wanted = math.atan(self.wheelbase * curvature) + UNDERSTEER * v_x * v_x * curvature
        wanted += _YAW_GAIN * (v_x * curvature - omega)
        wanted = min(_MAX_STEERING, max(-_MAX_STEERING, wanted))
        forward = (reference[1, V_X] - reference[0, V_X]) / self.dt
        noise_a, noise_delta_dot = self._advance_noise()
        a = forward + (reference[0, V_X] - v_x) / _SPEED_TIME + noise_a
        car = self.vehicle
        most = largest_demand(self.mu)
        strongest = min(car.a_max, car.power / max(v_x, 1.0), most)
        self._a = _limit(a, self._a, car.a_slew * self.dt, max(car.a_min, -most), strongest)
        self._delta_dot = _limit(
            (wanted - delta) / _STEERING_TIME + noise_delta_dot,
            self._delta_dot,
            car.steering_slew * self.dt,
            max(-car.steering_rate, (-car.steering_angle - delta) / self.dt),
            min(car.steering_rate, (car.steering_angle - delta) / self.dt),
        )
        return np.array([self.mass * self._a, self._delta_dot])

    def _advance_noise(self) -> tuple[float, float]:
        """Advance the Ornstein-Uhlenbeck processes by a period, exactly."""
        first, second = self.rng.standard_normal(2).tolist()
        self._noise = (
            _coloured(self._noise[0], first, self.dt / _A_TIME),
            _coloured(self._noise[1], second, self.dt / _DELTA_DOT_TIME),
        )
        a = min(2.0, 0.25 * largest_demand(self.mu))
        return a * self.noise * self._noise[0], 0.15 * self.noise * self._noise[1]


def _coloured(value: float, white: float, ratio: float) -> float:
    decay = math.exp(-ratio)
    return decay * value + math.sqrt(1.0 - decay * decay) * white


def _limit(wanted: float, last: float, slew: float, low: float, high: float) -> float:
    """Limit the rate, then the value; the bounds of the value take precedence."""
    return min(high, max(low, min(last + slew, max(last - slew, wanted))))
