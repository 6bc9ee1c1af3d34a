"""A vehicle reaches its service through a router only, and again after a restart of the router."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

import numpy as np

from egp_service import VehicleClient
from egp_service.simulation.scenario import gate_settings, library_path, load_scenario

if TYPE_CHECKING:
    from pathlib import Path

SCENARIO = load_scenario("rounded-rectangle")
# The goal of one second holds for a quiet machine; a busy one starts processes more slowly.
OUTAGE_SECONDS = 3.0
RESTARTS = 1


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def listens_at(endpoint: str) -> bool:
    host, _, port = endpoint.rpartition("/")[2].partition(":")
    with socket.socket() as probe:
        return probe.connect_ex((host, int(port))) == 0


def test_a_restarted_router_is_found_again(tmp_path: Path) -> None:
    """The service is a client of the router: it does not listen, so all goes through the router."""
    routed = free_endpoint()
    config = tmp_path / "service.toml"
    zenoh = {
        "mode": '"client"',
        "listen/endpoints": "[]",
        "connect/endpoints": json.dumps([routed]),
        "connect/timeout_ms": "20000",
    }
    lines = [f'"{key}" = {json.dumps(value)}' for key, value in zenoh.items()]
    text = f'library = "{library_path(SCENARIO)}"\n[zenoh]\n' + "\n".join(lines)
    config.write_text(text, encoding="utf-8")
    egp = [sys.executable, "-m", "egp_service"]
    with ExitStack() as running, (tmp_path / "log.txt").open("w") as log:

        def start(*command: str) -> subprocess.Popen[bytes]:
            process = subprocess.Popen([*egp, *command], stdout=log, stderr=log)
            running.callback(process.wait)
            running.callback(process.kill)
            return process

        start("serve", "--config", str(config))
        router = start("router", "--listen", routed)
        vehicle = VehicleClient.connect([routed], gate=gate_settings(SCENARIO), timeout=30.0)
        running.callback(vehicle.close)
        s = 15.0 * vehicle.dt * np.arange(vehicle.horizon + 1)
        zero = np.zeros_like(s)
        reference = np.column_stack([s, zero, zero + 15.0, zero])
        x = np.array([0.0, 0.3, 15.0, 0.0, 0.0, 0.0, 0.0])

        def answered() -> bool:
            begun = time.monotonic()
            step = vehicle.step(x, reference, deadline=0.2)
            assert np.isfinite(step.u).all()
            if step.mode == "stop":
                vehicle.reset()
            time.sleep(max(0.0, vehicle.dt - (time.monotonic() - begun)))
            return step.status == "solved"

        outages = []
        for _ in range(RESTARTS):
            assert all(answered() for _ in range(10))
            router.kill()
            router.wait()
            late = time.monotonic() + 10.0
            while answered():  # no link of its own leads from vehicle to service
                assert time.monotonic() < late
            router = start("router", "--listen", routed)
            while not listens_at(routed):
                answered()
            listens = time.monotonic()
            while not answered():
                assert time.monotonic() < listens + 10.0
            outages.append(time.monotonic() - listens)
        router.terminate()
        assert router.wait() == 0
    print(f"outages after the router listens: {[f'{outage:.2f} s' for outage in outages]}")
    assert max(outages) < OUTAGE_SECONDS
