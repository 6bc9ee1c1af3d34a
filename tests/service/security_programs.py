"""Programs, sessions and credentials of the tests of security."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
import pytest
import zenoh

from egp_service.simulation.scenario import gate_settings, library_path, load_scenario

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from egp_service import VehicleClient
    from egp_service.control.step import Step

SCENARIO = load_scenario("rounded-rectangle")
LIBRARY = library_path(SCENARIO)
GATE = gate_settings(SCENARIO)
STEPS = 25
# A link that is allowed is there within a tenth of this.
LINK_SECONDS = 1.5
# A busy machine starts a program within a third of this.
PATIENCE = 30.0


@contextmanager
def program(*command: str, folder: Path) -> Iterator[None]:
    """Run a program until the end of the block."""
    own = {name: value for name, value in os.environ.items() if name != "ZENOH_RUNTIME"}
    with (folder / "log.txt").open("a") as log:
        process = subprocess.Popen([sys.executable, *command], stdout=log, stderr=log, env=own)
    try:
        yield
    finally:
        process.kill()
        process.wait()


@contextmanager
def service(folder: Path, endpoint: str, *lines: str, router: bool = False) -> Iterator[None]:
    """Run `egp serve` with these lines of configuration, behind a router at the endpoint or not."""
    zenoh_lines = [f'"listen/endpoints" = \'["{endpoint}"]\'']
    if router:
        zenoh_lines = [
            '"mode" = \'"client"\'',
            "\"listen/endpoints\" = '[]'",
            f'"connect/endpoints" = \'["{endpoint}"]\'',
        ]
    config = folder / "service.toml"
    own = [f'library = "{LIBRARY}"', *lines, "[zenoh]", *zenoh_lines]
    config.write_text("\n".join(own), encoding="utf-8")
    with program("-m", "egp_service", "serve", "--config", str(config), folder=folder):
        yield


@contextmanager
def client(endpoint: str, file: Path | None = None) -> Iterator[zenoh.Session]:
    config = zenoh.Config() if file is None else zenoh.Config.from_file(file)
    for key, value in (
        ("connect/endpoints", [endpoint]),
        ("connect/timeout_ms", 3000),
        ("connect/exit_on_failure", False),
        ("connect/retry", {"period_init_ms": 50, "period_max_ms": 200}),
        ("listen/endpoints", []),
        ("scouting/multicast/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield session


def first(
    session: zenoh.Session, key: str, attachment: bytes | None = None, *, expected: bool = True
) -> zenoh.Sample | None:
    """Ask until there is an answer, because program and link may not be there yet."""
    end = time.monotonic() + (PATIENCE if expected else LINK_SECONDS)
    while time.monotonic() < end:
        for reply in session.get(key, attachment=attachment, timeout=2.0):
            if reply.ok is not None:
                return reply.ok
        time.sleep(0.05)
    return None


def drive(vehicle: VehicleClient) -> list[Step]:
    """Drive straight on, with the same measurement in each period.

    Each period has its time, as that of a car. Now and then zenoh's TLS loses a link for some
    hundredths of a second (docs/security.md, section 3).
    """
    s = 15.0 * vehicle.dt * np.arange(vehicle.horizon + 1)
    zero = np.zeros_like(s)
    reference = np.column_stack([s, zero, zero + 15.0, zero])
    x = np.array([0.0, 0.3, 15.0, 0.0, 0.0, 0.0, 0.0])
    steps = []
    for _ in range(STEPS):
        due = time.monotonic() + vehicle.dt
        # Far longer than a busy machine needs.
        steps.append(vehicle.step(x, reference, deadline=5.0))
        if steps[-1].mode == "stop":
            vehicle.reset()
        time.sleep(max(0.0, due - time.monotonic()))
    return steps


def secrets(folder: Path, endpoint: str) -> Path:
    """Write the files of `egp keys` for the vehicles a and b of the fleet f."""
    pytest.importorskip("cryptography", reason="the extra `security` is not installed")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    port = int(endpoint.rpartition(":")[2])
    write_credentials(folder, "f", ["a", "b"], hosts=["127.0.0.1"], port=port, days=1)
    return folder


def written(folder: Path) -> dict[str, bytes]:
    """Return the contents of all files in a folder."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}
