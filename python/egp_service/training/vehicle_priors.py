"""What is known about a vehicle before it is fitted, and the ranges that a fit searches."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from egp_service._core import FULL_SIZE

if TYPE_CHECKING:
    from egp_service._core import VehicleParameters


class Parameter(NamedTuple):
    """What is known about a parameter: a log-normal prior, and the range that a fit searches.

    `width` is the standard deviation of the logarithm. The values of this module are those of any
    vehicle: small cars to vans, tyres from ice to racing.
    """

    centre: float
    width: float
    low: float
    high: float


# A shape C above 2 would reverse the force at large slip, and with a shape below 1 the force would
# have no peak.
_COUPLING: Final = Parameter(1.0, 1.5, 0.1, 100.0)
_GRIP: Final = Parameter(0.8, 1.0, 0.005, 2.0)
_STIFFNESS: Final = Parameter(20.0, 0.8, 1.0, 100.0)
_SHAPE: Final = Parameter(1.4, 0.15, 1.05, 1.9)
BODY: Final = {
    "m": Parameter(1300.0, 0.5, 300.0, 4000.0),
    "l_f": Parameter(1.2, 0.3, 0.3, 3.0),
    "l_r": Parameter(1.4, 0.3, 0.3, 3.0),
    "k²": Parameter(1.6, 0.5, 0.2, 6.0),
    "h": Parameter(0.5, 0.3, 0.1, 1.5),
}
"""Parameters that do not depend on the road."""
TYRES: Final = {
    "D_d": _GRIP,
    "D_b": _GRIP,
    "e_df": _COUPLING,
    "e_bf": _COUPLING,
    "D_f": _GRIP,
    "B_f": _STIFFNESS,
    "C_f": _SHAPE,
    "e_dr": _COUPLING,
    "e_br": _COUPLING,
    "D_r": _GRIP,
    "B_r": _STIFFNESS,
    "C_r": _SHAPE,
}
"""Parameters of the tyres on a road."""
DRAG: Final = {"c_2": Parameter(4e-4, 0.7, 4e-6, 1e-2)}
"""Drag per mass in 1/m, which does not depend on the road."""
ROLLING: Final = {"c_0": Parameter(0.15, 0.7, 1.5e-3, 2.0)}
"""Rolling resistance on a road, m/s²."""
SINGLE_TRACK: Final = len(BODY) + len(TYRES)
"""Number of parameters without a resistance."""
PARAMETERS: Final = BODY | TYRES | ROLLING | DRAG
"""All parameters, in the order of `prior_mean.change`."""
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
