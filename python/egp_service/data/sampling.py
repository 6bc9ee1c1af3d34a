"""Random states and inputs, as in the paper's comparison with the standard GP.

A vehicle starts in a sampled state and is driven for a few periods with a sampled constant input;
the transitions are kept. Bounds depend on the surface. Yaw rate and sideslip exceed its friction,
because a member must also predict a car that arrives too fast from a surface with higher friction.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from egp_service._core import GRAVITY, EgpError
from egp_service.data import constant_inputs
from egp_service.data.experiment import check_range, largest_demand
from egp_service.quantities import F_X

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset
    from egp_service.data.experiment import Experiment


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
    data = constant_inputs.drive(experiment, start, inputs, (settle, keep), "random sampling")
    if data is None:
        raise EgpError(f"all {count} samples spun or stopped: narrow the bounds {bounds}")
    return data


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
