"""How much of the tyres a library of surfaces uses, and how well it drives on them.

usage: surface_laps.py LIBRARY [SEEDS]

LIBRARY is made by `egp train --recipe` with the shipped `surfaces-recipe.toml`. The first table has
the share of the front axle's largest lateral force that the bound on slip leaves on each surface.
The second one has laps of random tracks with measurement noise, on each surface and over all of
them, of the ensemble and of the member of the surface under the car (the oracle). SEEDS is the
number of runs of each, 20 unless stated.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import Library, Plant
from egp_service._core.testing import plant_initial_states
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE, Contender, make
from egp_service.evaluation.experiment import NOISE
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.scenario import Scenario, Speed, Track, Zone
from egp_service.workers import in_order, workers

if TYPE_CHECKING:
    from numpy.typing import NDArray

SURFACES: Final = ("dry", "wet", "snow", "ice")
GRIPS: Final = (0.8, 0.9)
SPEED: Final = 15.0
SHORT: Final = 1e-5  # s, in which the vehicle hardly moves
OMEGA, FRONT_WHEELS = 5, slice(23, 25)  # in the 29 states


def front_force(surface: str, slips: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lateral force of the simulated front axle at these slip angles, in any unit.

    The vehicle drives straight ahead, so the front wheels alone turn it, and they roll freely.
    """
    vehicle = np.zeros((len(slips), 7))
    vehicle[:, 2], vehicle[:, 6] = SPEED, slips
    before = plant_initial_states(vehicle)
    before[:, FRONT_WHEELS] *= np.cos(slips)[:, None]
    after, plant = before.copy(), Plant()
    for row in after:
        plant.state = row
        plant.step(np.zeros(2), SHORT, surface)
        row[:] = plant.state
    return np.asarray((after[:, OMEGA] - before[:, OMEGA]) / np.cos(slips))


def usable(surface: str, bound: float) -> float:
    """Largest force up to the slip `bound` as a share of the largest force at any slip."""
    slips = np.linspace(0.0, 0.5, 1001)
    force = front_force(surface, slips)
    force -= force[0]
    return float(force[slips <= bound].max() / force.max())


@dataclass(frozen=True)
class Lap:
    """A lap over zones of equal length on these surfaces."""

    library: str
    kind: str
    grip: float
    surfaces: tuple[str, ...]
    seed: int

    @property
    def row(self) -> str:
        """The table's row to which the lap belongs."""
        name = self.surfaces[0] if len(self.surfaces) == 1 else "all"
        return f"{name:5} {self.grip:4.0%}  {self.kind:9}"


def drive_lap(lap: Lap) -> tuple[bool, float, float]:
    """Whether the lap was completed, and RMS and largest lateral error in m."""
    zones = (Zone(n / len(lap.surfaces), surface=name) for n, name in enumerate(lap.surfaces))
    scenario = Scenario(
        name="surfaces",
        track=Track("random"),
        zones=tuple(zones),
        library=lap.library,
        seed=lap.seed,
        speed=Speed(grip=lap.grip, v_max=18.0, tyres=True),
        measurement=NOISE,
    )
    controller = make(Contender(lap.kind, lap.kind), scenario)
    summary = drive(scenario, controller, lambda _: None).summary
    return summary.ending.completed, summary.lateral_error.rms, summary.lateral_error.max


def main(library: str, seeds: int = 20) -> None:
    """Print both tables; the second one has `seeds` runs of each kind."""
    print("surface  bound on slip  share of the peak")
    for member in Library.load(library).members:
        share = usable(member.label, member.slip_bound)
        print(f"{member.label:7} {member.slip_bound:9.3f} rad {100 * share:16.1f} %")
    print("lap   grip  contender  completed  RMS, max m", flush=True)
    laps = [
        Lap(library, kind, grip, surfaces, seed)
        for surfaces in (*((name,) for name in SURFACES), SURFACES)
        for grip in GRIPS
        for kind in (ENSEMBLE, ORACLE)
        for seed in range(seeds)
    ]
    with workers() as pool:
        driven = zip(laps, in_order(pool, drive_lap, laps), strict=True)
        for row, runs in groupby(driven, lambda run: run[0].row):
            completed, rms, largest = np.transpose([result for _, result in runs])
            finished = f"{completed.sum():.0f}/{seeds}"
            print(
                f"{row}  {finished:9}  {np.median(rms):.4f}, {np.median(largest):.2f}", flush=True
            )


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3) or not all(text.isdigit() for text in sys.argv[2:]):
        sys.exit(__doc__)
    main(sys.argv[1], *(int(text) for text in sys.argv[2:]))
