"""The vehicle that a library is trained for, by its name or from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from egp_service._core import EgpError, VehicleParameters
from egp_service.files import read_toml

_SIMULATED: Final = "commonroad-"
# Magnitudes of model cars to trucks, and those that the control step supports.
_LIMITS: Final = {
    "mass": (1.0, 1e5),
    "yaw_inertia": (0.01, 1e7),
    "l_f": (0.01, 20.0),
    "l_r": (0.01, 20.0),
    "width": (0.05, 10.0),
    "a_min": (0.01, 100.0),
    "a_max": (0.01, 100.0),
    "power": (0.5, 5e3),
    "a_slew": (0.1, 1e5),
    "steering_angle": (0.01, 1.5),
    "steering_rate": (0.01, 10.0),
    "steering_slew": (0.05, 1e5),
    "peak_slip": (1e-3, 1.5),
    "lateral_grip": (1e-3, 5.0),
    "braking_grip": (1e-3, 5.0),
    "driving_grip": (1e-3, 5.0),
}
# Yaw inertia over mass l_f l_r, which is about 1 for most vehicles.
_INERTIAS: Final = (0.05, 20.0)


def simulated_name(number: int) -> str:
    """Name of the simulated vehicle of this CommonRoad number in datasets and libraries."""
    return f"{_SIMULATED}{number}"


def known_vehicle(name: str) -> VehicleParameters:
    """Return the parameters of a simulated vehicle by its name in datasets.

    Raises:
        EgpError: for the name of any other vehicle, whose parameters must be stated.

    """
    vehicle = simulated_vehicle(name)
    if vehicle is None:
        raise EgpError(
            f"the parameters of vehicle {name!r} are not known: state them in a TOML file and give "
            "it with --vehicle; `egp train --help` lists them"
        )
    return vehicle


def simulated_vehicle(name: str) -> VehicleParameters | None:
    """Return the parameters of a simulated vehicle, or None for the name of any other vehicle.

    Raises:
        EgpError: if the name has the form of a simulated vehicle's, but there is no such vehicle.

    """
    number = name.removeprefix(_SIMULATED)
    if number == name or not number.isdecimal():
        return None
    return VehicleParameters.commonroad(int(number))


def check_limits(vehicle: VehicleParameters, origin: str) -> None:
    """Check that a vehicle is one that can be controlled; `origin` is for errors.

    Raises:
        EgpError: naming the first value that is too small or too large, as one in another unit.

    """
    fields = vehicle.fields()
    for name, (least, most) in _LIMITS.items():
        value = fields[name]
        if not least <= abs(value) <= most:
            raise EgpError(
                f"{origin}: {name} is {value:g}: expected a magnitude of {least:g} to {most:g}; "
                "check its unit"
            )
    least, most = (share * vehicle.mass * vehicle.l_f * vehicle.l_r for share in _INERTIAS)
    if not least <= vehicle.yaw_inertia <= most:
        raise EgpError(
            f"{origin}: yaw_inertia is {vehicle.yaw_inertia:g}: expected {least:.3g} to {most:.3g} "
            "for this mass and these distances to the axles; check its unit"
        )


def within_limits(name: str, value: float) -> float:
    """Return the positive value of this field that `check_limits` accepts and is nearest."""
    least, most = _LIMITS[name]
    return min(max(value, least), most)


def read_vehicle(path: str | Path) -> VehicleParameters:
    """Read a vehicle's parameters from a TOML file with one line for each field.

    Raises:
        EgpError: naming the file, if it cannot be read or is not TOML, and the field that is
            missing, unknown or out of range, as `check_limits`.

    """
    _, fields = read_toml(Path(path))
    try:
        for name, value in fields.items():
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise TypeError(f"{name} is {value!r}: expected a number in SI units")  # noqa: TRY301
        vehicle = VehicleParameters(**fields)
    except (ValueError, TypeError) as error:
        raise EgpError(f"{path}: {error}") from error
    check_limits(vehicle, str(path))
    return vehicle
