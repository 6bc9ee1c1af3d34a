"""Parameters of data collection: vehicle with its disturbances, surface, period and limits."""

from __future__ import annotations

import dataclasses
from importlib.metadata import version
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import GRAVITY, EgpError, Plant, VehicleParameters, surface_friction
from egp_service.data.provenance import Provenance
from egp_service.vehicle import simulated_name

if TYPE_CHECKING:
    from numpy.typing import NDArray

SEEDS: Final = 1 << 63
"""Number of seeds, which are 0 and more; a recipe's file has no larger numbers."""
# m, within 8 % of both CommonRoad cars; it is used for the excitation only.
WHEELBASE: Final = 2.5


def largest_acceleration(
    v_x: NDArray[np.float64], vehicle: VehicleParameters
) -> NDArray[np.float64]:
    """Largest forward acceleration at speed `v_x`, m/s², by traction or engine power."""
    return np.minimum(vehicle.a_max, vehicle.power / np.maximum(v_x, 1.0))


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
