"""How many threads of zenoh send and receive, with TLS and without."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from security_programs import GATE, LIBRARY, secrets

from egp_service import zenoh_threads
from egp_service.control.endpoints import free_endpoint, why_unreachable
from egp_service.control.toml_text import dumps
from patience import PATIENCE, wait_until

if TYPE_CHECKING:
    from collections.abc import Iterator

ONE_FOR_BOTH = Counter({"tx": 1})
VEHICLE = """
import json, sys
from egp_service import VehicleClient
endpoint, gate, more = sys.argv[1], json.loads(sys.argv[2]), json.loads(sys.argv[3])
with VehicleClient.connect(endpoint, gate=gate, fleet="f", vehicle="a", timeout=30.0, **more):
    print("connected", flush=True)
    input()
"""


def without_threads() -> dict[str, str]:
    """Return the environment of a program that chooses the threads itself."""
    return {name: value for name, value in os.environ.items() if name != "ZENOH_RUNTIME"}


def threads(process: int) -> Counter[str]:
    """Count the threads that send and receive."""
    kinds = []
    for task in Path(f"/proc/{process}/task").iterdir():
        with suppress(OSError):  # the thread has ended
            kinds.append((task / "comm").read_text().strip().rpartition("-")[0])
    return Counter(kind for kind in kinds if kind in {"tx", "rx"})


@contextmanager
def service(folder: Path, table: dict[str, str], endpoint: str) -> Iterator[int]:
    """Run `egp serve` and give its process."""
    file = folder / "service.toml"
    listen = {"listen/endpoints": json.dumps([endpoint])}
    file.write_text(dumps({"library": str(LIBRARY), **table, "zenoh": listen}), encoding="utf-8")
    command = [sys.executable, "-m", "egp_service", "serve", "--config", str(file)]
    with subprocess.Popen(command, env=without_threads()) as process:
        try:
            wait_until(lambda: why_unreachable(endpoint.replace("tls/", "tcp/")) is None)
            yield process.pid
        finally:
            process.terminate()
            process.wait(PATIENCE)


@contextmanager
def vehicle(endpoint: str, more: dict[str, str]) -> Iterator[int]:
    """Connect a vehicle in a process of its own, and give this process."""
    command = [sys.executable, "-c", VEHICLE, endpoint, json.dumps(GATE), json.dumps(more)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=without_threads(), stdin=pipe, stdout=pipe) as process:
        assert process.stdout
        assert process.stdout.readline() == b"connected\n"
        yield process.pid
        process.communicate(b"\n", timeout=PATIENCE)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc lists the threads")
@pytest.mark.parametrize("encrypted", [True, False])
def test_with_tls_one_thread_sends_and_receives(tmp_path: Path, *, encrypted: bool) -> None:
    endpoint, table, more = free_endpoint(), dict[str, str](), dict[str, str]()
    if encrypted:
        made = secrets(tmp_path, endpoint)
        endpoint = endpoint.replace("tcp/", "tls/")
        table = {
            "zenoh_file": str(made / "service.json5"),
            "vehicle_keys": str(made / "vehicles.keys"),
        }
        own = made / "vehicles" / "f@a"
        more = {"zenoh_file": f"{own}.json5", "key_file": f"{own}.keys"}
    with service(tmp_path, table, endpoint) as replica, vehicle(endpoint, more) as car:
        for process in (replica, car):
            if encrypted:
                # A thread for calls that block has the same name, and ends after ten seconds.
                wait_until(partial(_has, process, ONE_FOR_BOTH))
            else:
                assert threads(process)["rx"] > 1


def _has(process: int, expected: Counter[str]) -> bool:
    return threads(process) == expected


def test_what_the_user_stated_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    stated = "(rx: (worker_threads: 3))"
    monkeypatch.setenv("ZENOH_RUNTIME", stated)
    zenoh_threads.use_default()
    zenoh_threads.use_for('["tls/127.0.0.1:7447"]')
    assert os.environ["ZENOH_RUNTIME"] == stated
