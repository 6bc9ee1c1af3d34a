"""Closed loop with the sensors of a real car, which are late, beside exact ones.

usage: late_sensors.py [SEEDS]

A member is trained on a drive of the simulated car that was measured by the default sensors of
`egp_service.data.sensors` (25 Hz, noise, quantisation, delay 0.040 s, filter 5 Hz). The delay that
the training finds is written into the library. The car then drives SEEDS (20) random tracks at 90 %
of the grip, with exact velocities and with those of the sensors, and with the library's delay or
none. Positions, yaw and steering angle are exact. Another member is trained on the exact drive. The
ratio that counts is that of the rows "measured, sensors, library's" and "exact, exact, none".
"""

from __future__ import annotations

import dataclasses
import math
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from rich.progress import track

from egp_service.data.collect import CollectionSettings, collect
from egp_service.data.experiment import Experiment
from egp_service.data.sensors import Sensors, measure
from egp_service.evaluation.contenders import Contender, make
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.scenario import Scenario, Speed, Track, Zone
from egp_service.training.export import export
from egp_service.training.train import TrainingSettings, train
from egp_service.vehicle import known_vehicle

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset

SENSORS: Final = Sensors()
DT: Final = 0.04
FRICTION: Final = 0.9
VELOCITIES: Final = (2, 4, 5)  # of the state [X, Y, v_x, yaw, v_y, omega, delta]
TRAINING: Final = TrainingSettings(mean="best")  # the default of `egp train`


class Sensed:
    """A controller that sees the velocities as the sensors measure them."""

    def __init__(self, controller: Any, seed: int) -> None:  # noqa: ANN401
        """Let the sensors begin with the first state."""
        self._controller = controller
        self._rng = np.random.default_rng(seed + 100)
        self._share = 1.0 - math.exp(-2.0 * math.pi * SENSORS.cutoff * DT)
        self._waiting: list[NDArray[np.float64]] = []

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        """Pass everything else on."""
        return getattr(self._controller, name)

    def step(self, x: NDArray[np.float64], *args: Any, **options: Any) -> Any:  # noqa: ANN401
        """Step with the filtered, late, noisy and rounded velocities."""
        exact = x[list(VELOCITIES)]
        if not self._waiting:
            self._waiting = [exact] * (SENSORS.delay + 1)
        last = self._waiting[-1]
        self._waiting.append(last + self._share * (exact - last))
        self._waiting = self._waiting[1:]
        noisy = self._waiting[0] + np.array(SENSORS.noise) * self._rng.standard_normal(3)
        quantum = np.array(SENSORS.quantum)
        measured = x.copy()
        measured[list(VELOCITIES)] = quantum * np.round(noisy / quantum)
        return self._controller.step(measured, *args, **options)


def library(data: Dataset, path: Path) -> None:
    """Train one member and write its library."""
    car = known_vehicle("commonroad-1")
    (member,) = train([data], TRAINING, vehicle=car)
    print(f"{path.stem}: delays found: {member.delays}", flush=True)
    export(path, [member], TRAINING, {}, car)


def laps(path: Path, seeds: range, *, sensed: bool, delay: float | None) -> str:
    """Completed laps, and the median of the RMS distance from the path in m."""
    errors = []
    control: dict[str, Any] = {} if delay is None else {"measurement_delay": delay}
    for seed in track(seeds, "Driving ...", transient=True):
        scenario = Scenario(
            name="late",
            track=Track("random"),
            zones=(Zone(0.0, FRICTION),),
            library=str(path),
            seed=seed,
            speed=Speed(grip=0.9, v_max=18.0),
            control=control,
        )
        controller = make(Contender("ensemble", "ensemble"), scenario)
        seen: Any = Sensed(controller, seed) if sensed else controller
        summary = drive(scenario, seen, lambda _: None).summary
        if summary.ending.completed:
            errors.append(summary.lateral_error.rms)
    return f"{len(errors)}/{len(seeds)} | {np.median(errors):.4f}"


def main() -> None:
    """Print the table."""
    seeds = range(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
    collection = CollectionSettings(runs=8, samples=0, steady=0)
    exact = collect(Experiment(FRICTION, "dry", 1, DT, 1), collection, jobs=1)
    seen = measure(exact, SENSORS, np.random.default_rng(0))
    # A vehicle that is not the simulated one: its log is searched for delays.
    logged = dataclasses.replace(seen.provenance, vehicle="car")
    with TemporaryDirectory() as folder:
        paths = {name: Path(folder) / f"{name}.safetensors" for name in ("exact", "measured")}
        library(exact, paths["exact"])
        library(dataclasses.replace(seen, provenance=logged), paths["measured"])
        print("| trained on | velocities in the loop | delay | completed | RMS, m |")
        print("|---|---|---|---|---|")
        for trained, sensed, delay in (
            ("exact", False, 0.0),
            ("exact", True, 0.0),
            ("measured", True, 0.0),
            ("measured", True, None),
        ):
            row = laps(paths[trained], seeds, sensed=sensed, delay=delay)
            told = "library's" if delay is None else "none"
            loop = "sensors" if sensed else "exact"
            print(f"| {trained} | {loop} | {told} | {row} |", flush=True)


if __name__ == "__main__":
    main()
