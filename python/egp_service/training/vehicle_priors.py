"""What is known about the parameters of a vehicle before it is fitted."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

from egp_service.training.prior_mean import PARAMETERS

if TYPE_CHECKING:
    from egp_service._core import VehicleParameters

KNOWN_WIDTHS: Final = {"m": 0.03, "l_f": 0.02, "l_r": 0.02, "k²": 0.15}
"""Widths of the priors that a vehicle's parameters give."""


@dataclasses.dataclass(frozen=True)
class Prior:
    """Log-normal prior of a parameter; `width` is the standard deviation of the logarithm."""

    centre: float
    width: float


def priors(vehicle: VehicleParameters | None) -> dict[str, Prior]:
    """Return the prior of each parameter, given the parameters of the vehicle or none."""
    general = {name: Prior(p.start, p.width) for name, p in PARAMETERS.items()}
    if vehicle is None:
        return general
    known = {
        "m": vehicle.mass,
        "l_f": vehicle.l_f,
        "l_r": vehicle.l_r,
        "k²": vehicle.yaw_inertia / vehicle.mass,
    }
    return general | {name: Prior(value, KNOWN_WIDTHS[name]) for name, value in known.items()}
