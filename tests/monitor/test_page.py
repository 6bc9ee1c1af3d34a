"""The live page in a browser: 50 simulated vehicles, and one that asks a service."""

from __future__ import annotations

import signal
import threading
import time
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import pytest

from egp_service.control.client import VehicleClient
from egp_service.control.service_process import ServiceProcess
from egp_service.control.status import StatusPublisher
from egp_service.simulation.scenario import gate_settings, library_path, load_scenario
from monitor.conftest import MonitorProcess
from monitor.simulated_fleet import SimulatedFleet

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser, Page

VEHICLES = 50
SCENARIO = load_scenario("rounded-rectangle")
X = [0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0]


class World:
    """Service, monitor, a fleet that publishes, and one vehicle that asks the service."""

    def __init__(self, service: ServiceProcess, monitor: MonitorProcess) -> None:
        self.service, self.monitor = service, monitor
        self._going_on = True
        self._fleet = SimulatedFleet(monitor.listen, VEHICLES)
        self._threads = [
            threading.Thread(target=self._fleet.publish, args=[lambda: self._going_on]),
            threading.Thread(target=self._drive),
        ]
        for thread in self._threads:
            thread.start()

    def _drive(self) -> None:
        """Ask for steps of a vehicle on a straight road; it does not move."""
        with (
            VehicleClient.connect(self.service.endpoint, gate=gate_settings(SCENARIO)) as client,
            StatusPublisher(client, self.monitor.listen, vehicle="asks") as status,
        ):
            ahead = [[10.0 * client.dt * i, 0.0, 10.0, 0.0] for i in range(client.horizon + 1)]
            began = due = time.monotonic()
            while self._going_on:
                status.add(client.step(X, ahead), X, time.monotonic() - began)
                due += client.dt
                time.sleep(max(0.0, due - time.monotonic()))

    def end(self) -> None:
        """Stop publishing and end the publications."""
        self._going_on = False
        for thread in self._threads:
            thread.join()
        self._fleet.close()


@pytest.fixture(scope="module")
def world(browser: Browser) -> Iterator[World]:
    del browser  # without one there is nothing to test
    with ServiceProcess(library_path(SCENARIO), SCENARIO.control) as service:
        monitor = MonitorProcess(service.endpoint)
        monitor.start()
        world = World(service, monitor)
        yield world
        world.end()
        monitor.end()


@pytest.fixture(scope="module")
def page(browser: Browser, world: World) -> Iterator[Page]:
    opened = browser.new_page(viewport={"width": 1400, "height": 900})
    mistakes: list[str] = []
    opened.on("pageerror", lambda error: mistakes.append(str(error)))
    opened.on(
        "request",
        lambda request: mistakes.append(request.url) if foreign(request.url, world) else None,
    )
    opened.goto(world.monitor.url)
    opened.locator("#rows tr").nth(VEHICLES).wait_for(state="attached", timeout=60_000)
    yield opened
    opened.close()
    assert mistakes == [], "errors of the scripts, or requests beyond the monitor"


def foreign(url: str, world: World) -> bool:
    return f"http://{urlsplit(url).netloc}" != world.monitor.url


def test_all_vehicles_are_shown_and_refreshed_ten_times_a_second(page: Page) -> None:
    assert page.locator("#rows tr").count() == VEHICLES + 1
    page.locator("#rows tr.normal").nth(VEHICLES - 1).wait_for(state="attached")
    gaps = page.evaluate(
        """async () => {
            const source = new EventSource("events");
            const times = [];
            await new Promise((done) => {
                source.onmessage = () => {
                    times.push(performance.now());
                    if (times.length > 20) done();
                };
            });
            source.close();
            return times.slice(1).map((time, i) => time - times[i]).sort((a, b) => a - b);
        }"""
    )
    # Between two events; 100 ms on an idle machine. A stall prolongs only some of them.
    assert gaps[len(gaps) // 2] <= 1000 / 7
    for name in (
        "Map",
        "Grip",
        "Weights",
        "Step time",
        "Lateral error",
        "Speed",
        "Force",
        "Steering",
    ):
        assert page.locator(f"canvas[aria-label^='{name}']").count() == 1
    drawn = page.evaluate(
        """() => [...document.querySelectorAll("canvas")].map((canvas) => {
            const pen = canvas.getContext("2d");
            const { data } = pen.getImageData(0, 0, canvas.width, canvas.height);
            return new Set(new Uint32Array(data.buffer)).size;
        })"""
    )
    assert min(drawn) > 5, "a canvas is empty"


def test_states_have_words_and_shapes_beside_their_colour(page: Page) -> None:
    cells = page.locator("#rows tr td:first-child")
    words = set(cells.all_inner_texts())
    assert words <= {"normal", "tail", "stop", "waiting", "silent", "ended"}
    assert page.locator("#rows tr td:first-child use").count() == cells.count()


def test_the_keyboard_selects_filters_and_changes_the_theme(page: Page) -> None:
    chosen = page.locator("#rows tr[aria-selected='true']")
    page.keyboard.press("End")
    last = chosen.get_attribute("data-id")
    page.keyboard.press("ArrowUp")
    assert chosen.get_attribute("data-id") != last
    assert page.evaluate("document.activeElement.dataset.id") == chosen.get_attribute("data-id")
    page.keyboard.press("/")
    page.keyboard.type("car-50")
    page.locator("#rows tr:not([hidden])").nth(1).wait_for(state="detached")
    page.keyboard.press("Escape")
    page.locator("#rows tr:not([hidden])").nth(VEHICLES).wait_for(state="attached")
    before = page.evaluate("document.documentElement.dataset.theme")
    assert before == "light"
    page.keyboard.press("t")
    page.keyboard.press("t")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    page.emulate_media(color_scheme="dark")
    page.keyboard.press("t")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"  # the system's


def test_nothing_is_cut_off_on_a_narrow_screen(page: Page) -> None:
    page.set_viewport_size({"width": 360, "height": 700})
    page.locator("#detail").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    page.set_viewport_size({"width": 1400, "height": 900})


def test_a_killed_service_is_shown_within_a_second(page: Page, world: World) -> None:
    page.wait_for_selector("#replicas li.serving")
    page.wait_for_selector("#rows tr[data-id='default/asks'].normal")
    began = time.monotonic()
    world.service.kill()
    page.wait_for_selector("#replicas li.gone", timeout=1000)
    page.wait_for_selector("#rows tr[data-id='default/asks']:is(.tail, .stop)", timeout=1000)
    assert time.monotonic() - began < 1.0
    first = page.locator("#rows tr").first
    assert first.get_attribute("data-id") == "default/asks"  # what needs attention is on top
    assert "gone" in page.locator("#replicas").inner_text()
    world.service.start()
    page.wait_for_selector("#replicas li.serving", timeout=60_000)


def test_a_page_says_that_its_monitor_ended_and_connects_again(page: Page, world: World) -> None:
    world.monitor.end(signal.SIGKILL)
    page.wait_for_selector("#alarm:not([hidden])", timeout=60_000)
    assert "old" in page.locator("#alarm").inner_text()
    world.monitor.start()
    page.wait_for_selector("#alarm", state="hidden", timeout=60_000)
    page.locator("#rows tr.normal").nth(VEHICLES - 1).wait_for(state="attached")
