"""The vehicle that a library is trained for, by its name or from a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from egp_service._core import EgpError, VehicleParameters
from egp_service.files import read_toml

if TYPE_CHECKING:
    from os import PathLike

_SIMULATED: Final = "commonroad-"


def simulated_name(number: int) -> str:
    """Name of the simulated vehicle of this CommonRoad number in datasets and libraries."""
    return f"{_SIMULATED}{number}"


def known_vehicle(name: str) -> VehicleParameters:
    """Return the parameters of a simulated vehicle by its name in datasets.

    The name of any other vehicle, whose parameters must be stated, is an error.
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


def check_own_name(name: str) -> None:
    """Check the name of a car that is not simulated by this package.

    Raises:
        EgpError: for the name of a simulated vehicle, as which training would treat its data.

    """
    if name.startswith(_SIMULATED):
        raise EgpError(
            f"vehicle {name}: names that begin with {_SIMULATED} are those of the simulated cars; "
            "give the vehicle, or its file, another name"
        )


def read_vehicle(path: str | PathLike[str]) -> VehicleParameters:
    """Read a vehicle's parameters from a TOML file with one line for each field.

    Raises:
        EgpError: naming the file, if it cannot be read or is not TOML, and the field that is
            missing, unknown or out of range.

    """
    _, fields = read_toml(Path(path))
    known = VehicleParameters.ranges()
    try:
        for name, value in fields.items():
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if name in known and not number:
                raise TypeError(f"{name} is {value!r}: expected a number in SI units")  # noqa: TRY301
        # A name that is not known is an error, whatever its value.
        return VehicleParameters(**{n: v if n in known else 0.0 for n, v in fields.items()})
    except (ValueError, TypeError) as error:
        raise EgpError(f"{path}: {error}") from error
