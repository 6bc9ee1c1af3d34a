"""A vehicle reaches its service through routers only, and again after a restart of a router."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import numpy as np
import zenoh

from egp_service import VehicleClient
from egp_service.control.endpoints import free_endpoint, why_unreachable
from egp_service.control.router import Router
from egp_service.simulation.scenario import gate_settings, library_path, load_scenario
from patience import ATTEMPTS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

SCENARIO = load_scenario("rounded-rectangle")
# The goal of one second holds for a quiet machine; a busy one starts processes more slowly.
OUTAGE_SECONDS = 3.0
# An outage that a stall prolongs is measured again.
RESTARTS = 3
# In three runs questions came twice after at most one restart.
RESTARTS_OF_TWO = 8
# A busy machine starts processes and links within a third of this.
PATIENCE = 30.0


@contextmanager
def programs(folder: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Give a function that starts a command of `egp`, which is killed at the end."""
    with ExitStack() as running, (folder / "log.txt").open("w") as log:

        def start(*command: str) -> subprocess.Popen[bytes]:
            words = [sys.executable, "-m", "egp_service", *command]
            process = subprocess.Popen(words, stdout=log, stderr=log)
            running.callback(process.wait)
            running.callback(process.kill)
            return process

        yield start


def client_of(routers: Sequence[str], folder: Path, *lines: str) -> str:
    """Write the configuration of a service that does not listen, so that all goes through them."""
    config = folder / "service.toml"
    zenoh_lines = {
        "mode": '"client"',
        "listen/endpoints": "[]",
        "connect/endpoints": json.dumps(routers),
    }
    own = [f'library = "{library_path(SCENARIO)}"', *lines, "[zenoh]"]
    own += [f'"{key}" = {json.dumps(value)}' for key, value in zenoh_lines.items()]
    config.write_text("\n".join(own), encoding="utf-8")
    return str(config)


def period(vehicle: VehicleClient, deadline: float) -> str:
    """Drive one control period, and return its status."""
    begun = time.monotonic()
    s = 15.0 * vehicle.dt * np.arange(vehicle.horizon + 1)
    zero = np.zeros_like(s)
    reference = np.column_stack([s, zero, zero + 15.0, zero])
    x = np.array([0.0, 0.3, 15.0, 0.0, 0.0, 0.0, 0.0])
    step = vehicle.step(x, reference, deadline=deadline)
    assert np.isfinite(step.u).all()
    if step.mode == "stop":
        vehicle.reset()
    time.sleep(max(0.0, vehicle.dt - (time.monotonic() - begun)))
    return step.status


def test_a_router_says_where_it_listens_although_its_file_has_endpoints_for_each_mode(
    tmp_path: Path,
) -> None:
    file, endpoint = tmp_path / "router.json5", free_endpoint()
    listen = {"endpoints": {"router": [endpoint], "peer": ["tcp/127.0.0.1:0"]}}
    file.write_text(json.dumps({"mode": "router", "listen": listen}), encoding="utf-8")
    with Router([], zenoh_file=file) as router:
        assert router.endpoints == (endpoint,)


def test_a_restarted_router_is_found_again(tmp_path: Path) -> None:
    routed = free_endpoint()
    with programs(tmp_path) as start:
        # The service waits for its routers, the first of which never runs.
        start("serve", "--config", client_of([free_endpoint(), routed], tmp_path))
        router = start("router", "--listen", routed)
        with VehicleClient.connect(
            [routed], gate=gate_settings(SCENARIO), timeout=PATIENCE
        ) as vehicle:

            def answered() -> bool:
                return period(vehicle, 0.2) == "solved"

            outages: list[float] = []
            while len(outages) < RESTARTS and min(outages, default=np.inf) >= OUTAGE_SECONDS:
                late = time.monotonic() + PATIENCE
                while not all(answered() for _ in range(10)):
                    assert time.monotonic() < late
                router.kill()
                router.wait()
                late = time.monotonic() + PATIENCE
                while answered():  # no link of its own leads from vehicle to service
                    assert time.monotonic() < late
                router = start("router", "--listen", routed)
                while why_unreachable(routed) is not None:
                    answered()
                listens = time.monotonic()
                while not answered():
                    assert time.monotonic() < listens + PATIENCE
                outages.append(time.monotonic() - listens)
        router.terminate()
        assert router.wait() == 0
    print(f"outages after the router listens: {[f'{outage:.2f} s' for outage in outages]}")
    assert min(outages) < OUTAGE_SECONDS


def test_a_vehicle_with_a_key_is_served_through_two_routers(tmp_path: Path) -> None:
    """The vehicle uses the reply although the copy of its question gets an error.

    Which of the routers' links a question takes depends on the order in which they were made, so
    routers are killed and started again until questions came twice, and each router once.
    """
    endpoints = [free_endpoint(), free_endpoint()]
    keys = tmp_path / "vehicles.keys"
    keys.write_text(f"default/car-1 {'5e' * 32}\n", encoding="utf-8")
    with programs(tmp_path) as start, ExitStack() as running:

        def route(k: int) -> subprocess.Popen[bytes]:
            return start("router", "--listen", endpoints[k], "--connect", endpoints[1 - k])

        routers = [route(0), route(1)]
        start("serve", "--config", client_of(endpoints, tmp_path, f'vehicle_keys = "{keys}"'))
        vehicle = running.enter_context(
            VehicleClient.connect(
                endpoints,
                vehicle="car-1",
                gate=gate_settings(SCENARIO),
                key_file=keys,
                timeout=PATIENCE,
            )
        )

        def statuses(count: int) -> set[str]:
            return {period(vehicle, 0.5) for _ in range(count)}

        def settle() -> None:
            late = time.monotonic() + PATIENCE
            while statuses(20) != {"solved"}:
                assert time.monotonic() < late

        def drive_undisturbed() -> None:
            """Drive 100 periods, again if a stall of the machine may have delayed an answer."""
            for _ in range(ATTEMPTS):
                found = statuses(100)
                assert found <= {"solved", "late"}
                if found == {"solved"}:
                    return
            raise AssertionError(f"late in each of {ATTEMPTS} attempts")

        settle()
        restarts = 0
        while restarts < 2 or (unauthenticated(endpoints[0]) == 0 and restarts < RESTARTS_OF_TWO):
            k = restarts % 2
            routers[k].kill()
            routers[k].wait()
            settle()
            routers[k] = route(k)
            while why_unreachable(endpoints[k]) is not None:
                statuses(1)
            settle()
            drive_undisturbed()
            restarts += 1
        assert unauthenticated(endpoints[0]) > 0


def unauthenticated(endpoint: str) -> int:
    """Ask how many requests the service found not to be its vehicle's, or to have come before."""
    config = zenoh.Config()
    for key, value in (
        ("connect/endpoints", [endpoint]),
        ("connect/timeout_ms", 5000),
        ("listen/endpoints", []),
        ("scouting/multicast/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    late = time.monotonic() + PATIENCE
    with zenoh.open(config) as session:
        while time.monotonic() < late:
            for reply in session.get("egp/v1/r/main/metrics", timeout=2.0):
                if reply.ok is not None:
                    text = reply.ok.payload.to_string()
                    found = re.search(r'requests_total\{outcome="unauthenticated"\} (\d+)', text)
                    return 0 if found is None else int(found[1])
            time.sleep(0.05)
    raise AssertionError("no answer")
