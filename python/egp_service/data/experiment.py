"""What a collection run is about: vehicle, surface, period, and how hard it may steer and brake."""

from __future__ import annotations

import dataclasses
from importlib.metadata import version
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import Plant
from egp_service.data.dataset import Provenance

if TYPE_CHECKING:
    from numpy.typing import NDArray

GRAVITY: Final = 9.81
# Limits of the controller that will use the data; it must not plan what the data do not show.
MIN_A: Final = -8.0
MAX_A: Final = 6.0
POWER: Final = 54.7  # m²/s³, largest a * v_x
MAX_DELTA_DOT: Final = 0.4
MAX_DELTA: Final = 0.91
A_SLEW: Final = 60.0
DELTA_DOT_SLEW: Final = 8.0
# Both CommonRoad cars are within 8 % of it; it only shapes the excitation.
WHEELBASE: Final = 2.5


def largest_acceleration(v_x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest forward acceleration at speed `v_x`, m/s²: traction, above it engine power."""
    return np.minimum(MAX_A, POWER / np.maximum(v_x, 1.0))


def tool() -> str:
    """Name this program and its version, for the provenance of data and libraries."""
    return f"egp-service {version('egp-service')}"


@dataclasses.dataclass(frozen=True)
class Experiment:
    """One vehicle on one surface."""

    friction: float
    """Friction coefficient mu of the whole surface."""
    label: str
    """The surface's name; files of the same name become one member."""
    seed: int = 0
    """Seed of everything random."""
    dt: float = 0.02
    """Control period, s."""
    vehicle: int = 1
    """CommonRoad's number: 1 Ford Escort, 2 BMW 320i."""

    @property
    def mass(self) -> float:
        """Mass of the vehicle, kg."""
        return Plant(self.vehicle).mass

    def provenance(self, method: str) -> Provenance:
        """Describe data of this experiment that `method` made."""
        return Provenance(
            dt=self.dt,
            vehicle=f"commonroad-{self.vehicle}",
            surface=self.label,
            friction=self.friction,
            seed=self.seed,
            method=method,
            tool=tool(),
        )
