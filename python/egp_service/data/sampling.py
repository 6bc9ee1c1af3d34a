"""Random states and inputs, as in the paper's comparison with the standard GP.

A vehicle starts in a sampled state and is driven for a few periods with a sampled constant input;
the transitions are kept. Bounds depend on the surface. Yaw rate and sideslip exceed its friction,
because a member must also predict a car that arrives too fast from a surface with higher friction.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import GRAVITY, EgpError, VehicleLostError
from egp_service.data.dataset import Dataset
from egp_service.data.experiment import (
    Experiment,
    SimulatedVehicle,
    check_range,
    largest_demand,
)
from egp_service.quantities import DELTA, F_X, NY, NZ, OMEGA, V_X, V_Y

if TYPE_CHECKING:
    from numpy.typing import NDArray

_VISIBLE: Final = (V_X, V_Y, OMEGA, DELTA)  # columns of the state
_STANDSTILL: Final = 0.5  # m/s; slower vehicles count as standing


@dataclasses.dataclass(frozen=True)
class SamplingBounds:
    """Bounds of the uniform distributions of states and inputs."""

    v_x: tuple[float, float] = (2.0, 27.0)
    """Speed, m/s."""
    sideslip: float = 0.2
    """Largest angle between heading and course, rad."""
    lateral: float = 1.2
    """Largest lateral acceleration v_x * omega, in units of mu * g."""
    steering: float = 0.15
    """Largest deviation from the steering angle of a vehicle without slip, rad."""
    omega: float = 1.2
    """Largest yaw rate, rad/s."""

    def __post_init__(self) -> None:
        """Check the ranges of the values."""
        check_range("v_x", self.v_x, 0.0, 100.0)
        for name in ("sideslip", "lateral", "steering", "omega"):
            check_range(name, getattr(self, name), 0.0, 10.0)


def sample(
    experiment: Experiment,
    count: int,
    bounds: SamplingBounds | None = None,
    *,
    settle: int = 2,
    keep: int = 3,
) -> Dataset:
    """Drive `count` vehicles from random states for `settle + keep` periods; keep the last ones.

    In the first `settle` periods the suspension, which starts at rest, reaches its state. Vehicles
    that spin are left out.

    Raises:
        EgpError: if the vehicle is unknown to the plant, or if every sample spun.

    """
    bounds = bounds or SamplingBounds()
    rng = np.random.default_rng(experiment.seed)
    start, inputs = _draw(experiment, count, settle + keep, bounds, rng)
    inputs[:, F_X] *= experiment.mass
    vehicle = experiment.simulated()
    driven = [
        _drive(experiment, vehicle, x, u, settle + keep) for x, u in zip(start, inputs, strict=True)
    ]
    alive = [number for number, states in enumerate(driven) if states is not None]
    survivors = len(alive)
    if survivors == 0:
        raise EgpError(f"all {count} samples spun or stopped: narrow the bounds {bounds}")
    visible = np.array([states for states in driven if states is not None])[:, settle:, _VISIBLE]
    repeated = np.repeat(inputs[alive][:, None, :], keep, axis=1)
    z = np.concatenate([visible[:, :-1], repeated], axis=2)
    return Dataset(
        z=z.reshape(-1, NZ),
        y=np.diff(visible[:, :, :NY], axis=1).reshape(-1, NY),
        trajectory=np.repeat(np.arange(survivors, dtype=np.uint32), keep),
        step=np.tile(np.arange(keep, dtype=np.uint32), survivors),
        provenance=experiment.provenance("random sampling"),
    )


def _drive(
    experiment: Experiment,
    vehicle: SimulatedVehicle,
    x: NDArray[np.float64],
    u: NDArray[np.float64],
    periods: int,
) -> NDArray[np.float64] | None:
    """Drive from the state x (7,) with the input u (2,); return the states (periods + 1, 7).

    None if the vehicle spun or stopped.
    """
    vehicle.reset(x)
    states = [vehicle.state]
    for _ in range(periods):
        try:
            vehicle.step(u, experiment.dt, experiment.friction)
        except VehicleLostError:
            return None
        states.append(vehicle.state)
        if states[-1][V_X] <= _STANDSTILL:
            return None
    return np.array(states)


def _draw(
    experiment: Experiment,
    count: int,
    periods: int,
    bounds: SamplingBounds,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw vehicle states (count, 7) and inputs [a, delta_dot] (count, 2) of so many periods."""
    v_x = rng.uniform(*bounds.v_x, count)
    lateral = bounds.lateral * experiment.mu * GRAVITY * rng.uniform(-1.0, 1.0, count)
    omega = np.clip(lateral / v_x, -bounds.omega, bounds.omega)
    # Sideslip is reduced at low speed, where it decays within a period.
    sideslip = bounds.sideslip * rng.uniform(-1.0, 1.0, count) * np.minimum(1.0, v_x / 8.0)
    delta = np.arctan(experiment.wheelbase * omega / v_x)
    delta += bounds.steering * rng.uniform(-1.0, 1.0, count)
    car = experiment.parameters
    stop = max(0.0, experiment.steering_stop - periods * experiment.dt * car.steering_rate)
    delta = np.clip(delta, -stop, stop)
    zero = np.zeros(count)
    states = np.column_stack([zero, zero, v_x, zero, v_x * np.tan(sideslip), omega, delta])
    most = largest_demand(experiment.mu)
    strongest = np.minimum(car.a_max, car.power / np.maximum(v_x, 1.0))
    a = rng.uniform(max(car.a_min, -most), np.minimum(most, strongest))
    delta_dot = rng.uniform(-car.steering_rate, car.steering_rate, count)
    return states, np.column_stack([a, delta_dot])
