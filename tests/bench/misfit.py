"""Whether `Friction.misfit` tells a vehicle that the members of the demo's library do not predict.

Random roads of unknown friction with the noise of the evaluation: the median over the informed
windows of each run, and the median, the smallest and the largest of four runs.

    python tests/bench/misfit.py          # one minute
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from egp_service import VehicleParameters
from egp_service.evaluation.experiment import NOISE
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.scenario import Disturbances, Measurement, Scenario, load_scenario

ROAD = replace(load_scenario("random"), measurement=NOISE)
OTHER = VehicleParameters.commonroad(1).gate_limits()  # of the library's vehicle
CONDITIONS = {
    "its own car": ROAD,
    "its own car, exact sensors": replace(ROAD, measurement=Measurement()),
    "bank of 0.05 rad": replace(ROAD, disturbances=Disturbances(bank=0.05)),
    "load of 300 kg, 0.4 m to the left": replace(
        ROAD, disturbances=Disturbances(load=300.0, load_y=0.4)
    ),
    "rear tyres with 30 % less": replace(ROAD, disturbances=Disturbances(wear_rear=0.3)),
    "a BMW 320i": replace(ROAD, vehicle=2, gate=OTHER),
}


def misfit(scenario: Scenario) -> float:
    """Drive a road; return the median misfit of its informed windows."""
    with in_process_controller(scenario) as controller:
        found = drive(scenario, controller, lambda _: None).summary.friction
    return np.nan if found is None or found.misfit is None else found.misfit


def main() -> None:
    """Drive and print."""
    print("| vehicle | misfit |\n|---|---|")
    for name, scenario in CONDITIONS.items():
        found = [misfit(replace(scenario, seed=seed)) for seed in range(4)]
        print(
            f"| {name} | {np.median(found):.2f} ({min(found):.2f}-{max(found):.2f}) |", flush=True
        )


if __name__ == "__main__":
    main()
