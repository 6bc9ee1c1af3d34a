"""Vehicles that publish the steps of one short simulated run again and again.

As a program it publishes a fleet until it is ended, for looking at the page and for measurements:

    python tests/monitor/simulated_fleet.py --vehicles 50 --endpoint tcp/127.0.0.1:7450
"""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

from egp_service.control.endpoints import MONITOR_ENDPOINT
from egp_service.control.status import StatusPublisher
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.recording import plant_truth
from egp_service.simulation.scenario import load_scenario
from egp_service.simulation.scene import vehicle_road

if TYPE_CHECKING:
    from collections.abc import Callable

    from egp_service.simulation.trace import Period


class SimulatedFleet:
    """Publishes the recorded periods of one car as those of many, each shifted in time."""

    def __init__(self, endpoint: str, vehicles: int, *, laps: float = 0.05) -> None:
        """Drive this part of a lap once, and connect the vehicles."""
        scenario = replace(load_scenario("rounded-rectangle"), laps=laps)
        self._periods: list[Period] = []
        self._stack = ExitStack()
        with in_process_controller(scenario) as controller:
            drive(scenario, controller, self._periods.append)
            self.dt = controller.dt
            road = vehicle_road(scenario)

            def connect(i: int) -> StatusPublisher:
                return StatusPublisher(controller, endpoint, vehicle=f"car-{i + 1}", road=road)

            # A session waits while it opens.
            with ThreadPoolExecutor(max_workers=16) as pool:
                self._vehicles = list(pool.map(connect, range(vehicles)))
            for vehicle in self._vehicles:
                self._stack.push(vehicle)

    def publish(self, going_on: Callable[[], bool]) -> None:
        """Publish in real time, each vehicle once every control period, while `going_on()`."""
        due, tick = time.monotonic(), 0
        while going_on():
            for i, vehicle in enumerate(self._vehicles):
                period = self._periods[(tick + 7 * i) % len(self._periods)]
                vehicle.add(
                    replace(period.step, replica="main"),
                    period.measured,
                    period.truth.time,
                    lateral_error=period.truth.lateral_error,
                    truth=plant_truth(period),
                )
            tick += 1
            due += self.dt
            time.sleep(max(0.0, due - time.monotonic()))

    def close(self) -> None:
        """End the publications."""
        self._stack.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=50)
    parser.add_argument("--endpoint", default=MONITOR_ENDPOINT)
    parser.add_argument("--laps", type=float, default=1.0)
    chosen = parser.parse_args()
    fleet = SimulatedFleet(chosen.endpoint, chosen.vehicles, laps=chosen.laps)
    fleet.publish(lambda: True)
