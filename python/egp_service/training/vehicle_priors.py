"""What is known about a vehicle before it is fitted, and the ranges that a fit searches."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from egp_service._core import FULL_SIZE
from egp_service.training.prior_mean import PARAMETERS, Parameter

if TYPE_CHECKING:
    from egp_service._core import VehicleParameters

KNOWN_WIDTHS: Final = {"m": 0.03, "l_f": 0.02, "l_r": 0.02, "k²": 0.15}
"""Widths of the priors that a vehicle's parameters give."""
# The range of a vehicle that is no car of usual size is this factor about its parameters.
_FACTOR: Final = 4.0


def priors(vehicle: VehicleParameters | None) -> dict[str, Parameter]:
    """Return the prior of each parameter, given the parameters of the vehicle or none.

    The ranges are those of cars and vans, unless the parameters of the vehicle are outside: a model
    car, a kart or a lorry has a quarter to four times its own, and a centre of mass as high as that
    of a car in proportion to the distance of the axles.
    """
    if vehicle is None:
        return PARAMETERS
    known = {
        "m": vehicle.mass,
        "l_f": vehicle.l_f,
        "l_r": vehicle.l_r,
        "k²": vehicle.yaw_inertia / vehicle.mass,
    }
    body = {
        name: PARAMETERS[name]._replace(centre=value, width=KNOWN_WIDTHS[name])
        for name, value in known.items()
    }
    if not all(low < value < high for value, _, low, high in body.values()):
        body = {
            name: own._replace(low=own.centre / _FACTOR, high=own.centre * _FACTOR)
            for name, own in body.items()
        }
        h, size = PARAMETERS["h"], (vehicle.l_f + vehicle.l_r) / FULL_SIZE
        body["h"] = Parameter(size * h.centre, h.width, size * h.low, size * h.high)
    return PARAMETERS | body
