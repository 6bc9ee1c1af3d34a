"""Logs of the simulated car, sound and with the mistakes that people make.

As a script it imports 40 sound and 40 corrupted logs, and prints how many were accepted:

    python tests/train/log_faults.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import polars as pl

from egp_service import EgpError, VehicleParameters
from egp_service.data.collect import CollectionSettings, collect
from egp_service.data.experiment import Experiment
from egp_service.data.log_import import Column, import_log
from egp_service.data.provenance import Provenance

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Log = dict[str, NDArray[np.float64]]

DT: Final = 0.02
UNITS: Final = {
    "time": "s",
    "v_x": "m/s",
    "v_y": "m/s",
    "omega": "rad/s",
    "delta": "rad",
    "F_x": "N",
}
# Standard deviations of sensors' noise in the second of two sound logs of a drive.
NOISE: Final = {"v_x": 0.03, "v_y": 0.03, "omega": 0.003, "delta": 0.001, "F_x": 50.0}
FRICTIONS: Final = (1.1, 0.8, 0.5, 0.3)
STUCK: Final = 24.0  # s
OUTLIER: Final = 99.0  # m/s


def drive(seed: int) -> Log:
    """Drive the car once; its surface depends on the seed. Each trajectory begins after a gap."""
    friction = FRICTIONS[seed % len(FRICTIONS)]
    experiment = Experiment(friction, "log", seed, DT, 1, {})
    data = collect(experiment, CollectionSettings(runs=1, samples=0, steady=0), jobs=1)
    breaks = np.diff(data.trajectory.astype(np.int64)) != 0
    time = np.concatenate(([0.0], np.cumsum(np.where(breaks, 1.0, DT))))
    return {"time": time} | {
        name: data.z[:, column].copy()
        for column, name in enumerate(("v_x", "v_y", "omega", "delta", "F_x"))
    }


def noisy(log: Log, rng: np.random.Generator) -> Log:
    """Add the noise of sensors."""
    return {
        name: values + NOISE.get(name, 0.0) * rng.standard_normal(len(values))
        for name, values in log.items()
    }


def _milliseconds(log: Log, _: np.random.Generator) -> Log:
    return log | {"time": 1e-3 * log["time"]}


def _kilometres(log: Log, _: np.random.Generator) -> Log:
    return log | {"v_x": log["v_x"] / 3.6, "v_y": log["v_y"] / 3.6}


def _metres(log: Log, _: np.random.Generator) -> Log:
    return log | {"v_x": log["v_x"] * 3.6, "v_y": log["v_y"] * 3.6}


def _sign(log: Log, _: np.random.Generator) -> Log:
    return log | {"omega": -log["omega"]}


def _outlier(log: Log, rng: np.random.Generator) -> Log:
    values = log["v_x"].copy()
    values[rng.integers(len(values))] = OUTLIER
    return log | {"v_x": values}


def _stuck(log: Log, rng: np.random.Generator) -> Log:
    name = ("v_x", "omega", "v_y", "delta")[rng.integers(4)]
    values = log[name].copy()
    count = round(STUCK / DT)
    first = int(rng.integers(len(values) - count))
    values[first : first + count] = values[first]
    return log | {name: values}


def _swapped(log: Log, _: np.random.Generator) -> Log:
    return log | {"v_x": log["v_y"], "v_y": log["v_x"]}


def _steering(log: Log, _: np.random.Generator) -> Log:
    return log | {"delta": 20.0 * log["delta"]}


FAULTS: Final[dict[str, Callable[[Log, np.random.Generator], Log]]] = {
    "seconds read as milliseconds": _milliseconds,
    "m/s read as km/h": _kilometres,
    "km/h read as m/s": _metres,
    "yaw rate of the wrong sign": _sign,
    "one sample of 99 m/s": _outlier,
    "a sensor stuck for 24 s": _stuck,
    "v_x and v_y swapped": _swapped,
    "steering times 20": _steering,
}


def verdict(log: Log, folder: Path, *, mass_known: bool = True) -> str | None:
    """Import a log, and return the error or `None`."""
    path = folder / "log.csv"
    pl.DataFrame(log).write_csv(path)
    columns = {name: Column(name, unit) for name, unit in UNITS.items()}
    provenance = Provenance(DT, "commonroad-1", "log", 0.8, 0, "test", "test")
    try:
        mass = VehicleParameters.commonroad(1).mass if mass_known else None
        import_log(path, columns, provenance, mass=mass)
    except EgpError as error:
        return str(error)
    return None


def main() -> None:
    """Import all logs and print what was wrong."""
    rng = np.random.default_rng(0)
    sound, caught, counted = 0, 0, 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        logs = []
        for seed in range(20):
            log = drive(seed)
            logs += [log, noisy(log, rng)]
        for number, log in enumerate(logs):
            error = verdict(log, folder)
            sound += error is None
            if error is not None:
                print(f"sound log {number} was rejected: {error}")
        for number, log in enumerate(logs):
            kind = list(FAULTS)[number % len(FAULTS)]
            error = verdict(FAULTS[kind](log, rng), folder)
            counted += 1
            caught += error is not None
            print(f"{kind}: {error or 'ACCEPTED'}")
    print(f"{sound} of {len(logs)} sound logs accepted, {caught} of {counted} corrupted ones not")


if __name__ == "__main__":
    main()
