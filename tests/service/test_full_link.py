"""A vehicle that reads no replies delays no other vehicle."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import zenoh

from egp_service import Controller, VehicleClient
from egp_service._core.testing import step_key
from egp_service.control.endpoints import free_endpoint
from egp_service.control.toml_text import dumps
from egp_service.simulation.scenario import gate_settings, library_path, load_scenario, told_zones
from patience import ATTEMPTS

if TYPE_CHECKING:
    from pathlib import Path

SCENARIO = told_zones(load_scenario("rounded-rectangle"))
LIBRARY = library_path(SCENARIO)
GATE = gate_settings(SCENARIO)
BESIDE = np.array([0.0, 0.3, 15.0, 0.0, 0.0, 0.0, 0.0])
# Names under which the vehicle that reads nothing asks 200 times a second.
NAMES = 64
PAUSE = 0.005
SECONDS = 5.0
# Requests in that time that more than fill the link.
ENOUGH = 300
# Time before, in which the service has nothing else to do.
QUIET_SECONDS = 1.0


class Measured(NamedTuple):
    """Steps of a vehicle by status, before and while another one reads no replies."""

    before: Counter[str]
    beside: Counter[str]
    # Requests of the other vehicle.
    asked: int


def straight(controller: Controller | VehicleClient) -> np.ndarray:
    """Return a straight reference at 15 m/s."""
    s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
    return np.column_stack([s, 0.0 * s, 0.0 * s + 15.0, 0.0 * s])


def served(client: VehicleClient, seconds: float) -> Counter[str]:
    """Count the steps of a vehicle by status."""
    statuses = Counter[str]()
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        step = client.step(BESIDE, straight(client))
        statuses[step.status] += 1
        if step.mode == "stop":
            client.reset()
        time.sleep(client.dt)
    return statuses


def is_mostly_solved(statuses: Counter[str]) -> bool:
    return statuses["solved"] >= 0.5 * statuses.total()


def served_beside_a_full_link(folder: Path, zenoh_settings: dict[str, str]) -> Measured:
    """Count the steps of a vehicle, before and while another one reads no replies.

    The queries of the latter ask for zenoh's blocking congestion control, as `get` does by default.
    """
    with Controller(LIBRARY, gate=GATE) as controller:
        request = controller.step(BESIDE, straight(controller), deadline=5.0).request
    endpoint = free_endpoint()
    # Small buffers of the system fill up soon.
    listen = {"listen/endpoints": json.dumps([f"{endpoint}#so_sndbuf=16384"])}
    file = folder / "service.toml"
    table = {"library": str(LIBRARY), "zenoh": listen | zenoh_settings}
    file.write_text(dumps(table), encoding="utf-8")
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps([f"{endpoint}#so_rcvbuf=16384"]))
    reading, over = threading.Event(), threading.Event()

    def wait(_: zenoh.Reply) -> None:
        reading.wait()

    asked = 0

    def ask() -> None:
        nonlocal asked
        while not over.wait(PAUSE):
            key = step_key("main", "fleet", f"silent-{asked % NAMES}")
            # The callback keeps the thread that receives.
            waiting = zenoh.handlers.Callback(wait, indirect=False)
            silent.get(key, waiting, payload=request, timeout=30.0)
            asked += 1

    command = [sys.executable, "-m", "egp_service", "serve", "--config", str(file)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as service:
        try:
            with (
                VehicleClient.connect([endpoint], gate=GATE, timeout=30.0) as client,
                zenoh.open(config) as silent,
            ):
                before = served(client, QUIET_SECONDS)
                asking = threading.Thread(target=ask)
                asking.start()
                beside = served(client, SECONDS)
                measured = Measured(before, beside, asked)
                over.set()
                reading.set()
                asking.join()
        finally:
            service.kill()
    return measured


def test_replies_that_a_link_has_no_room_for_hold_no_worker(tmp_path: Path) -> None:
    measured = []
    for _ in range(ATTEMPTS):  # a busy machine may answer most steps too late
        measured.append(served_beside_a_full_link(tmp_path, {}))
        if measured[-1].asked >= ENOUGH and is_mostly_solved(measured[-1].beside):
            return
    raise AssertionError(measured)


def test_without_the_default_of_qos_network_they_do(tmp_path: Path) -> None:
    """Replies that wait for room, as zenoh sends them by default, make the test above fail."""
    measured = []
    for _ in range(ATTEMPTS):  # steps that a busy machine answers too late show nothing
        measured.append(served_beside_a_full_link(tmp_path, {"qos/network": "[]"}))
        before, beside, asked = measured[-1]
        if asked >= ENOUGH and is_mostly_solved(before):
            assert not is_mostly_solved(beside), measured
            return
    raise AssertionError(measured)
