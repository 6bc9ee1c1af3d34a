"""A log of the simulated car, as docs/your-data.md writes it."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Final

import numpy as np
import polars as pl

from egp_service import Plant
from egp_service.data.log_import import Column

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Log = dict[str, NDArray[np.float64]]

MASS: Final = 1225.887
COLUMNS: Final = {
    name: Column(name, unit)
    for name, unit in (
        ("time", "s"),
        ("v_x", "m/s"),
        ("v_y", "m/s"),
        ("omega", "rad/s"),
        ("delta", "rad"),
        ("a_x", "m/s2"),
    )
}


@functools.cache
def _rows(straight: int) -> NDArray[np.float64]:
    car = Plant()
    car.reset(0.0, 0.0, 0.0, 8.0)
    rows = []
    for k in range(1500):
        _, _, v_x, _, v_y, omega, delta = car.vehicle_state
        force = 600.0 + 1800.0 * np.sin(0.05 * k)
        rate = 0.12 * np.sin(0.06 * (k - straight) + 1.5) if k >= straight else 0.0
        rows.append([0.02 * k, v_x, v_y, omega, delta, force / MASS])
        car.step(np.array([force, rate]), 0.02, 0.8)
    return np.array(rows)


def plant_log(straight: int = 0) -> Log:
    """Return the columns of a drive of 30 s in SI units, which is straight for some rows first."""
    return {name: column.copy() for name, column in zip(COLUMNS, _rows(straight).T, strict=True)}


def options(path: Path, log: Log) -> list[str]:
    """Write a log as CSV, and return the options of `egp collect` that import it."""
    pl.DataFrame(log).write_csv(path)
    columns = [f"{name}={column.name}:{column.unit}" for name, column in COLUMNS.items()]
    named = [option for column in columns for option in ("--column", column)]
    return ["--friction", "0.8", "--from-log", str(path), "--mass", str(MASS), *named]
