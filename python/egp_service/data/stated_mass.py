"""Checks of the mass that is stated for a log, by which accelerations become forces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from egp_service._core import EgpError

if TYPE_CHECKING:
    from pathlib import Path

_LIGHTEST: Final = 50.0  # kg, of a car without a file
# The largest ratio of the stated mass to that of the car's file, or its inverse, which a load has.
_LOAD: Final = 1.5


def check_unit(mass: float | None, vehicle: str, *, is_file: bool) -> None:
    """Check that a mass is not stated in t; `vehicle` is the car's name, or its file if `is_file`.

    Raises:
        EgpError: if the mass is that of no car.

    """
    if mass is None or not 0.0 < mass < _LIGHTEST:
        return
    light = (
        f"leave out --mass: {vehicle} states it"
        if is_file
        else "a car that is so light needs a file, given with --vehicle"
    )
    raise EgpError(
        f"--mass {mass:g} is below {_LIGHTEST:g} kg: state kg, such as {1e3 * mass:g} for "
        f"{mass:g} t; {light}"
    )


def of_car(mass: float | None, known: float, file: Path) -> float:
    """Return the stated mass in kg, or without one the `known` mass of the car's file.

    Raises:
        EgpError: if the masses differ by more than a load does.

    """
    if mass is None:
        return known
    if mass > 0.0 and not 1.0 / _LOAD <= mass / known <= _LOAD:
        raise EgpError(
            f"--mass {mass:g} kg is {mass / known:.3g} times the mass in {file}, {known:g} kg, and "
            "all forces would be wrong by this ratio: leave out --mass, or correct the file"
        )
    return mass
