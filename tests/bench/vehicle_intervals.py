"""Compares the intervals of a fitted vehicle with the simulated car's true parameters.

    python tests/bench/vehicle_intervals.py [SEEDS]

Each seed (4 unless stated) has a log of its own, three runs on tracks, which is fitted without a
vehicle's file: once as it is, and once as sensors with noise, a filter and a delay of a period
measure it. A line has the fitted values with their 95 % intervals.
"""

from __future__ import annotations

import sys

import numpy as np
import torch

from egp_service import VehicleParameters
from egp_service.data.collect import CollectionSettings, collect
from egp_service.data.experiment import Experiment
from egp_service.data.sensors import Sensors, measure
from egp_service.training.vehicle_fit import fit_vehicle


def main(seeds: int) -> None:
    """Print the fits, and how many intervals hold the true values."""
    car = VehicleParameters.commonroad(1)
    # The axles are those of CommonRoad's file; `car` rounds them.
    true = {"m": car.mass, "l_f": 0.884, "l_r": 1.509, "k²": car.yaw_inertia / car.mass}
    print("true:", ", ".join(f"{name} {value:.4g}" for name, value in true.items()))
    held = 0
    for seed in range(seeds):
        experiment = Experiment(0.9, "dry", seed, 0.02, 1)
        exact = collect(experiment, CollectionSettings(runs=3, samples=0, steady=0), jobs=1)
        measured = measure(exact, Sensors(), np.random.default_rng(seed))
        for name, data in (("exact", exact), ("sensors", measured)):
            (fitted,) = fit_vehicle([data], None, [np.random.default_rng(seed)])
            found = {p.name: p for p in fitted.parameters if p.name in true}
            held += sum(p.low <= true[p.name] <= p.high for p in found.values())
            texts = [f"{p.name} {p.value:.4g} ({p.low:.4g}-{p.high:.4g})" for p in found.values()]
            print(f"seed {seed}, {name}:", ", ".join(texts), flush=True)
    print(f"{held} of {2 * seeds * len(true)} intervals hold the true value.")


if __name__ == "__main__":
    torch.set_num_threads(1)
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
