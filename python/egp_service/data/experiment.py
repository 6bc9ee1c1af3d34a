"""Parameters of data collection: vehicle with its disturbances, surface, period and limits.

The vehicle is the built-in one, or a user's simulator.
"""

from __future__ import annotations

import dataclasses
import math
from importlib.metadata import version
from typing import TYPE_CHECKING, Final, Protocol

from egp_service._core import GRAVITY, EgpError, Plant, VehicleParameters, surface_friction
from egp_service.data.provenance import Provenance
from egp_service.quantities import DELTA, OMEGA, P_X, P_Y, PSI, V_X, V_Y
from egp_service.vehicle import simulated_name

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

SEEDS: Final = 1 << 63
"""Number of seeds, which are 0 and more; a recipe's file has no larger numbers."""
# m, within 8 % of both CommonRoad cars; it is used for the excitation only.
WHEELBASE: Final = 2.5


def largest_demand(mu: float) -> float:
    """Largest acceleration or deceleration in data on friction `mu`, m/s²: twice the grip.

    With the vehicle's whole range, data on ice would consist of spinning and locked wheels.
    """
    return 2.0 * mu * GRAVITY


def tool() -> str:
    """Name this program and its version, for the provenance of data and libraries."""
    return f"egp-service {version('egp-service')}"


def parse_surface(text: str) -> float | str:
    """Return the friction coefficient that the text states, or the text as the name of a preset."""
    try:
        return float(text)
    except ValueError:
        return text


def check_seed(seed: int) -> None:
    """Errors if the seed is outside its range."""
    if not 0 <= seed < SEEDS:
        raise EgpError(f"seed is {seed}: expected a whole number from 0 to 2^63 - 1")


def check_range(
    name: str, value: float | tuple[float, ...], least: float, most: float, *, ordered: bool = True
) -> None:
    """Errors if a value, or one of several, is outside a range, or if these are not ascending."""
    values = value if isinstance(value, tuple) else (value,)
    if not all(least <= number <= most for number in values):
        raise EgpError(f"{name} is {value}: expected {least:g} to {most:g}")
    if ordered and list(values) != sorted(values):
        raise EgpError(f"{name} is {value}: expected the smaller number first")


class SimulatedVehicle(Protocol):
    """What drives for data; states are `[p_x, p_y, v_x, psi, v_y, omega, delta]` in SI units."""

    def reset(self, x: NDArray[np.float64]) -> None:
        """Put the vehicle into the state `x` (7,)."""

    def step(self, u: NDArray[np.float64], dt: float, friction: float | str) -> None:
        """Drive `dt` seconds with the constant input `u = [F_x, delta_dot]` on one surface.

        Raises:
            VehicleLostError: if the vehicle has spun, or its state is no longer finite.

        """

    @property
    def state(self) -> NDArray[np.float64]:
        """The state (7,)."""


class _BuiltIn:
    """The plant as a `SimulatedVehicle`."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant

    def reset(self, x: NDArray[np.float64]) -> None:
        self._plant.reset(
            x=x[P_X], y=x[P_Y], yaw=x[PSI], v=x[V_X], yaw_rate=x[OMEGA], v_y=x[V_Y], delta=x[DELTA]
        )

    def step(self, u: NDArray[np.float64], dt: float, friction: float | str) -> None:
        self._plant.step(u, dt, friction)

    @property
    def state(self) -> NDArray[np.float64]:
        return self._plant.vehicle_state


@dataclasses.dataclass(frozen=True)
class Experiment:
    """One vehicle on one surface."""

    friction: float | str
    """Friction coefficient mu of the whole surface, or the name of a preset (`dry`, `wet`, `snow`,
    `ice`)."""
    label: str
    """The surface's name; datasets of the same name are merged into one member."""
    seed: int = 0
    """Seed of all random numbers."""
    dt: float = 0.02
    """Control period, s."""
    vehicle: int = 1
    """CommonRoad's number, as for `VehicleParameters.commonroad`."""
    disturbances: dict[str, float] = dataclasses.field(default_factory=dict)
    """What the vehicle has beyond a single-track model, by the names of the table `disturbances` of
    a scenario; 0 unless stated."""

    def __post_init__(self) -> None:
        """Check all values; errors are those of `plant`, `mu` and `Provenance`."""
        try:
            check_seed(self.seed)
            self.plant()
            self.provenance("")
        except (TypeError, OverflowError) as error:
            raise EgpError(
                f"surface {self.label!r} has friction {self.friction!r}, dt {self.dt!r}, seed "
                f"{self.seed!r}, vehicle {self.vehicle!r} and disturbances "
                f"{self.disturbances!r}: expected a coefficient or the name of a preset as "
                "friction, a period in s, whole numbers as seed and vehicle, and a number for "
                "each disturbance"
            ) from error

    def plant(self) -> Plant:
        """Return the simulated vehicle, at rest.

        Raises:
            EgpError: if there is no such vehicle or disturbance, or a value is out of range.

        """
        return Plant(self.vehicle, self.disturbances)

    def simulated(self) -> SimulatedVehicle:
        """Return what drives for the data."""
        return _BuiltIn(self.plant())

    @property
    def mu(self) -> float:
        """Friction coefficient by which the surface is labelled: the peak of a preset.

        Raises:
            EgpError: if there is no such preset, or if the coefficient is not positive.

        """
        return surface_friction(self.friction)

    @property
    def parameters(self) -> VehicleParameters:
        """The vehicle's parameters for a controller, which the inputs of the data do not exceed."""
        return VehicleParameters.commonroad(self.vehicle)

    @property
    def mass(self) -> float:
        """Mass of the vehicle without a load, kg."""
        return self.plant().mass

    @property
    def wheelbase(self) -> float:
        """Distance of the axles that the driver assumes, m."""
        return WHEELBASE

    @property
    def steering_stop(self) -> float:
        """Largest steering angle of random states, rad: the built-in car has stops of its own."""
        return math.inf

    def provenance(self, method: str) -> Provenance:
        """Return the provenance of data that `method` collected in this experiment."""
        if isinstance(self.friction, str):
            method = f"{method} on {self.friction}"
        if self.disturbances:
            values = (f"{name} {value:g}" for name, value in sorted(self.disturbances.items()))
            method = f"{method} with {', '.join(values)}"
        return Provenance(
            dt=self.dt,
            vehicle=simulated_name(self.vehicle),
            surface=self.label,
            friction=self.mu,
            seed=self.seed,
            method=method,
            tool=tool(),
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class OwnExperiment(Experiment):
    """One vehicle of a user's simulator on one surface; it has no `disturbances`."""

    name: str
    """Name of the vehicle in datasets."""
    car: VehicleParameters
    """The vehicle's parameters, which replace those of `vehicle`."""
    simulator: str
    """The simulator as `module:Class`."""
    make: Callable[[str], SimulatedVehicle]
    """Makes the simulator by its name; other processes import this function."""

    def simulated(self) -> SimulatedVehicle:
        """Return a new simulator; errors if it cannot be made."""
        return self.make(self.simulator)

    @property
    def parameters(self) -> VehicleParameters:
        """The vehicle's parameters, which the inputs of the data do not exceed."""
        return self.car

    @property
    def mass(self) -> float:
        """Mass of the vehicle, kg."""
        return self.car.mass

    @property
    def wheelbase(self) -> float:
        """Distance of the axles, m."""
        return self.car.l_f + self.car.l_r

    @property
    def steering_stop(self) -> float:
        """Largest steering angle of random states, rad: a simulator need not have stops."""
        return self.car.steering_angle

    def provenance(self, method: str) -> Provenance:
        """Return the provenance of data that `method` collected with the simulator."""
        origin = super().provenance(f"{method} in {self.simulator}")
        return dataclasses.replace(origin, vehicle=self.name)
