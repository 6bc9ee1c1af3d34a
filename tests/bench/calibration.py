"""How often the 90 % interval of the friction holds the true value.

usage: calibration.py [FIRST]

Drives 12 random roads, with the seeds from FIRST (0) on, of friction 0.25 to 1.1 at 50, 75 and 90 %
of the grip with the noise of the evaluation and the demo's library. Counted are the informed
windows that lie on one surface.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.evaluation.experiment import jittered, on_surfaces
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.scenario import Track

if TYPE_CHECKING:
    from egp_service.simulation.trace import Period

ROADS: Final = 12
GRIPS: Final = (0.5, 0.75, 0.9)
FRICTIONS: Final = (0.25, 1.1)
WINDOW: Final = 25  # transitions
INFORMED: Final = 0.1  # nats


def windows(trial: tuple[int, float]) -> list[tuple[float, bool, float, float]]:
    """Grip, whether the interval holds the true value, its width and the error of the mean."""
    seed, grip = trial
    road = replace(on_surfaces(Track("random"), ((0.0, 1.0),), grip), seed=seed)
    scenario = jittered(road, FRICTIONS)
    truth: list[float] = []
    found: list[tuple[float, bool, float, float]] = []

    def observe(period: Period) -> None:
        truth.append(period.truth.friction)
        friction = period.step.friction
        alike = len(truth) > WINDOW and len(set(truth[-WINDOW - 1 :])) == 1
        if friction is not None and friction.information >= INFORMED and alike:
            holds = friction.lower <= truth[-1] <= friction.upper
            error = abs(friction.mean - truth[-1])
            found.append((grip, holds, friction.upper - friction.lower, error))

    drive(scenario, in_process_controller(scenario), observe)
    return found


def main(first: int) -> None:
    """Print the shares by grip, and the medians of width and error."""
    roads = range(first, first + ROADS)
    with ProcessPoolExecutor() as pool:
        rows = np.array([row for lap in pool.map(windows, product(roads, GRIPS)) for row in lap])
    grip, holds, width, error = rows.T
    for value in GRIPS:
        print(f"{value:.0%} of the grip: {np.mean(holds[grip == value]):.1%} held")
    print(f"all {len(rows)} windows: {np.mean(holds):.1%} held")
    print(f"median width {np.median(width):.2f}, median error {np.median(error):.3f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
