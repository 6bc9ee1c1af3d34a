"""Draws docs/monitor.png: the live page half a minute after a service was started, then killed.

    python tests/monitor/picture.py

It needs Chromium (`make browser`) and takes 45 s. Of 26 vehicles one asks the service, stops when
the service is gone, and one ends without a word at the same time.
"""

from __future__ import annotations

import os
import shutil
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parents[1]))

from egp_service.control.client import VehicleClient
from egp_service.control.service_process import ServiceProcess
from egp_service.control.status import StatusPublisher
from egp_service.simulation.scenario import gate_settings, library_path, load_scenario
from monitor.conftest import MonitorProcess
from monitor.simulated_fleet import SimulatedFleet

if TYPE_CHECKING:
    from collections.abc import Callable

PICTURE: Final = Path(__file__).parents[2] / "docs/monitor.png"
VIEW: Final = {"width": 1500, "height": 1000}
SCENARIO: Final = load_scenario("rounded-rectangle")
X: Final = [0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0]
SERVED, GONE = 30.0, 9.0  # s


def ask(service: str, monitor: str, vehicle: str, going_on: Callable[[], bool]) -> None:
    """Ask the service for steps of a vehicle on a straight road, and publish them."""
    with VehicleClient.connect(service, vehicle=vehicle, gate=gate_settings(SCENARIO)) as client:
        status = StatusPublisher(client, monitor, vehicle=vehicle)
        ahead = [[10.0 * client.dt * i, 0.0, 10.0, 0.0] for i in range(client.horizon + 1)]
        began = due = time.monotonic()
        while going_on():
            status.add(client.step(X, ahead), X, time.monotonic() - began)
            due += client.dt
            time.sleep(max(0.0, due - time.monotonic()))


def main() -> None:
    """Show the fleet, kill the service, and take the picture."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        sys.exit("no Chromium found; on Debian `make browser` installs it")
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    served, shown = threading.Event(), threading.Event()
    served.set()
    shown.set()
    with (
        ServiceProcess(library_path(SCENARIO), SCENARIO.control) as service,
        sync_playwright() as playwright,
    ):
        monitor = MonitorProcess(service.endpoint)
        monitor.start()
        fleet = SimulatedFleet(monitor.listen, 24, laps=1.0)
        threads = [threading.Thread(target=fleet.publish, args=[shown.is_set])] + [
            threading.Thread(target=ask, args=[service.endpoint, monitor.listen, name, going_on])
            for name, going_on in (("lorry-7", shown.is_set), ("lorry-8", served.is_set))
        ]
        for thread in threads:
            thread.start()
        browser = playwright.chromium.launch(executable_path=chromium, args=options)
        page = browser.new_page(viewport=VIEW)  # type: ignore[arg-type]
        page.goto(monitor.url)
        page.locator("#rows tr[data-id='default/car-3']").click()
        page.wait_for_timeout(1e3 * SERVED)
        served.clear()
        service.kill()
        page.wait_for_timeout(1e3 * GONE)
        page.screenshot(path=PICTURE)
        browser.close()
        shown.clear()
        for thread in threads:
            thread.join()
        fleet.close()
        monitor.end()


if __name__ == "__main__":
    main()
