"""Steady inputs: vehicles with a constant force and steering angle, on straights and in bends.

Vehicles on tracks and in random states change their inputs all the time, and suspension and wheels
change with them. From such data alone a member predicts driving at constant speed, and starts with
a strong drive, by what happens in transients and slides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import GRAVITY, EgpError
from egp_service.data import constant_inputs
from egp_service.data.driver import UNDERSTEER

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset
    from egp_service.data.experiment import Experiment

_SETTLE: Final = 0.5  # s of driving that is not recorded
_RECORDED: Final = 0.5  # s
_SLOWEST: Final = 1.0  # m/s at the start
_MOVING: Final = 0.6  # m/s at the end of the strongest braking
_SIDESLIP: Final = 0.2  # rad, largest angle between heading and course
_LATERAL: Final = 0.6  # largest lateral acceleration, in units of mu * g
_STRONG: Final = 0.5  # share of the vehicles whose largest acceleration is mu * g
_GENTLE: Final = 1.0  # m/s², largest acceleration of the others


def steady(experiment: Experiment, count: int, fastest: float) -> Dataset:
    """Drive `count` vehicles with steady inputs that start at up to `fastest` m/s.

    Speed, lateral acceleration and force are drawn uniformly. Vehicles that slide or stop are left
    out. Those that become slower than `VehicleParameters.slip_speed` drive straight ahead: in bends
    a single-track vehicle has slip there that a real one has not.

    Raises:
        EgpError: if the vehicle is unknown to the plant, or if every vehicle slid or stopped.

    """
    rng = np.random.default_rng((experiment.seed, count))
    start, inputs = _draw(experiment, count, fastest, rng)
    settle, recorded = (max(1, round(time / experiment.dt)) for time in (_SETTLE, _RECORDED))
    data = constant_inputs.drive(
        experiment, start, inputs, (settle, recorded), "steady inputs", sideslip=_SIDESLIP
    )
    if data is None:
        raise EgpError(f"all {count} vehicles with steady inputs slid or stopped: leave them out")
    return data


def _draw(
    experiment: Experiment, count: int, fastest: float, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw states (count, 7) of bends without slip, and inputs [F_x, 0] (count, 2)."""
    car, grip, duration = experiment.parameters, experiment.mu * GRAVITY, _SETTLE + _RECORDED
    v = rng.uniform(_SLOWEST, max(_SLOWEST, fastest), count)
    a = np.where(rng.random(count) < _STRONG, grip, _GENTLE) * rng.uniform(-1.0, 1.0, count)
    weakest = np.maximum(car.a_min, (_MOVING - v) / duration)
    a = np.clip(a, weakest, np.minimum(car.a_max, car.power / v))
    curvature = _LATERAL * grip * rng.uniform(-1.0, 1.0, count) / v**2
    curvature[v + np.minimum(a, 0.0) * duration < car.slip_speed] = 0.0
    delta = np.arctan(experiment.wheelbase * curvature) + UNDERSTEER * v**2 * curvature
    delta = np.clip(delta, -experiment.steering_stop, experiment.steering_stop)
    zero = np.zeros(count)
    states = np.column_stack([zero, zero, v, zero, zero, v * curvature, delta])
    return states, np.column_stack([experiment.mass * a, zero])
