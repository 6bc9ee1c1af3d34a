"""How often the 90 % interval of the friction holds the true value, and what `misfit` tells.

usage: calibration.py [FIRST]

Drives 12 random roads, with the seeds from FIRST (0) on, of friction 0.25 to 1.1 at 50, 75 and 90 %
of the grip with the noise of the evaluation: the car of the shipped libraries and cars with
libraries of their own, which are made first, and then vehicles that the demo's library was not made
for. Counted are the informed windows that lie on one surface. A second table tells how these
vehicles drive at a speed that is planned for what was found. Takes six minutes on two cores.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final, NamedTuple

import model_car
import numpy as np
from rich.console import Console
from rich.progress import track

from egp_service import VehicleParameters, shipped
from egp_service._core import write_library_subset
from egp_service.evaluation.experiment import jittered, on_surfaces
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.scenario import Disturbances, Measurement, Scenario, Track
from egp_service.training.export import export
from egp_service.training.recipe import Recipe, follow, training_provenance

if TYPE_CHECKING:
    from collections.abc import Iterator
    from concurrent.futures import Executor

    from egp_service.simulation.trace import Period

CONSOLE: Final = Console(stderr=True)
ROADS: Final = 12
GRIPS: Final = (0.5, 0.75, 0.9)
FRICTIONS: Final = (0.25, 1.1)
WINDOW: Final = 25  # transitions
OWN: Final = on_surfaces(Track("random"), ((0.0, 1.0),), 1.0)
FORD: Final = VehicleParameters.commonroad(1).gate_limits()
SMALL_ROAD: Final = Track(
    "random", parameters={"length": 80.0, "min_radius": 1.5, "track_width": 1.8}
)


class Window(NamedTuple):
    """What an informed window says about the friction."""

    grip: float
    holds: bool
    width: float
    error: float
    misfit: float


# Other vehicles and roads for the demo's library.
OTHER: Final = {
    "bank of 0.05 rad": replace(OWN, disturbances=Disturbances(bank=0.05)),
    "load of 300 kg, 0.4 m to the left": replace(
        OWN, disturbances=Disturbances(load=300.0, load_y=0.4)
    ),
    "rear tyres with 30 % less": replace(OWN, disturbances=Disturbances(wear_rear=0.3)),
    "a BMW 320i in place of the Ford": replace(OWN, vehicle=2, gate=FORD),
}


def bmw(library: Path) -> Scenario:
    """Make a library of CommonRoad's second car by the shipped recipe of disturbances."""
    recipe = Recipe.read(shipped.DISTURBANCE_RECIPE)
    surfaces = tuple(replace(surface, vehicle=2, disturbances={}) for surface in recipe.experiments)
    _, members = follow(replace(recipe, experiments=surfaces))
    export(library, members, recipe.training, training_provenance(recipe.training))
    return replace(OWN, library=str(library), vehicle=2)


def small_car(folder: Path) -> Scenario:
    """Make a library of a car of 1:10 from noisy logs (`model_car.py`)."""
    car = model_car.scenario(folder, model_car.track())
    return replace(car, track=SMALL_ROAD, zones=OWN.zones, zones_in_metres=False)


def conditions(folder: Path) -> Iterator[tuple[str, Scenario]]:
    """Give each vehicle with its library, made in `folder`, and its road."""
    yield "demo's library, its car", OWN
    yield "the same, exact sensors", replace(OWN, measurement=Measurement())
    four = folder / "four.safetensors"
    write_library_subset(shipped.EVALUATION_LIBRARY, four, range(4))
    yield "the evaluation's four members", replace(OWN, library=str(four))
    yield "a BMW 320i with its library", bmw(folder / "bmw.safetensors")
    yield "a car of 1:10 with its library", small_car(folder)
    yield from OTHER.items()


def windows(scenario: Scenario, trial: tuple[int, float]) -> list[Window]:
    """Drive a road; return what each informed window on one surface says."""
    seed, grip = trial
    scenario = replace(scenario, speed=replace(scenario.speed, grip=grip), seed=seed)
    scenario = jittered(scenario, FRICTIONS)
    truth: list[float] = []
    found: list[Window] = []

    def observe(period: Period) -> None:
        truth.append(period.truth.friction)
        friction = period.step.friction
        alike = len(truth) > WINDOW and len(set(truth[-WINDOW - 1 :])) == 1
        if friction is not None and friction.informed and alike:
            holds = friction.lower <= truth[-1] <= friction.upper
            width, error = friction.upper - friction.lower, friction.mean - truth[-1]
            found.append(Window(grip, holds, width, error, friction.misfit))

    drive(scenario, in_process_controller(scenario), observe)
    return found


def lap(scenario: Scenario, seed: int) -> float:
    """Drive a lap at a speed that is planned for what was found; return its time, or NaN."""
    speed = replace(scenario.speed, grip=max(GRIPS), knows="nothing")
    scenario = jittered(replace(scenario, speed=speed, seed=seed), FRICTIONS)
    ending = drive(scenario, in_process_controller(scenario), lambda _: None).summary.ending
    return ending.time if ending.completed else np.nan


def print_windows(pool: Executor, roads: range) -> None:
    """Print what the windows of each vehicle say."""
    columns = [f"{grip:.0%} of the grip" for grip in GRIPS]
    print("| vehicle | held | " + " | ".join(columns) + " | width | error | misfit |")
    print("|---" * 8 + "|")
    with TemporaryDirectory() as folder:
        for name, scenario in conditions(Path(folder)):
            laps = pool.map(partial(windows, scenario), product(roads, GRIPS))
            shown = track(laps, name, ROADS * len(GRIPS), transient=True, console=CONSOLE)
            grip, holds, width, error, misfit = np.array([row for rows in shown for row in rows]).T
            held = [np.mean(holds), *(np.mean(holds[grip == value]) for value in GRIPS)]
            shares = " | ".join(f"{share:.1%}" for share in held)
            print(
                f"| {name} | {shares} | {np.median(width):.2f} | {np.median(np.abs(error)):.3f} | "
                f"{np.median(misfit):.2f} |",
                flush=True,
            )


def print_laps(pool: Executor, roads: range) -> None:
    """Print how the vehicles drive that the demo's library was not made for."""
    print("\n| vehicle | completed | time, of its car |\n|---|---|---|")
    own = np.array(list(pool.map(partial(lap, OWN), roads)))
    for name, scenario in OTHER.items():
        laps = track(pool.map(partial(lap, scenario), roads), name, ROADS, console=CONSOLE)
        times = np.array(list(laps))
        ratio = np.nanmedian(times / own)
        print(f"| {name} | {np.isfinite(times).sum()} of {ROADS} | {ratio:.2f} |", flush=True)


def main(first: int) -> None:
    """Print both tables."""
    roads = range(first, first + ROADS)
    with ProcessPoolExecutor() as pool:
        print_windows(pool, roads)
        print_laps(pool, roads)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
