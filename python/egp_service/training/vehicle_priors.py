"""What is known about a vehicle before it is fitted, and the ranges that a fit searches."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

from egp_service._core import FULL_SIZE
from egp_service.training.prior_mean import PARAMETERS

if TYPE_CHECKING:
    from egp_service._core import VehicleParameters

KNOWN_WIDTHS: Final = {"m": 0.03, "l_f": 0.02, "l_r": 0.02, "k²": 0.15}
"""Widths of the priors that a vehicle's parameters give."""
# The range of a vehicle that is no car of usual size is this factor about its parameters.
_FACTOR: Final = 4.0


@dataclasses.dataclass(frozen=True)
class Prior:
    """Log-normal prior of a parameter; `width` is the standard deviation of the logarithm."""

    centre: float
    width: float
    low: float
    """Ends of the range that a fit searches."""
    high: float


def priors(vehicle: VehicleParameters | None) -> dict[str, Prior]:
    """Return the prior of each parameter, given the parameters of the vehicle or none.

    The ranges are those of cars and vans, unless the parameters of the vehicle are outside: a model
    car, a kart or a lorry has a quarter to four times its own, and a centre of mass as high as that
    of a car in proportion to the distance of the axles.
    """
    general = {name: Prior(p.start, p.width, p.low, p.high) for name, p in PARAMETERS.items()}
    if vehicle is None:
        return general
    known = {
        "m": vehicle.mass,
        "l_f": vehicle.l_f,
        "l_r": vehicle.l_r,
        "k²": vehicle.yaw_inertia / vehicle.mass,
    }
    usual = all(general[name].low < value < general[name].high for name, value in known.items())
    body = {}
    for name, value in known.items():
        low, high = general[name].low, general[name].high
        if not usual:
            low, high = value / _FACTOR, value * _FACTOR
        body[name] = Prior(value, KNOWN_WIDTHS[name], low, high)
    if not usual:
        h, size = general["h"], (vehicle.l_f + vehicle.l_r) / FULL_SIZE
        body["h"] = Prior(size * h.centre, h.width, size * h.low, size * h.high)
    return general | body
