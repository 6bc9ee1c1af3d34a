"""A vehicle with a secret key drives no plan that its service did not make, and strangers get none.

Service, vehicle and strangers are zenoh sessions in processes of their own.
"""

from __future__ import annotations

import hashlib
import hmac
import shutil
import socket
import struct
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from security_programs import (
    GATE,
    LIBRARY,
    PATIENCE,
    STEPS,
    client,
    drive,
    first,
    program,
    service,
)
from typer.testing import CliRunner

from egp_service import EgpError, VehicleClient
from egp_service._core import Discovery, Server
from egp_service.cli import app
from egp_service.cli.signing import sign_library
from egp_service.control.endpoints import free_endpoint
from patience import wait_for_replicas

if TYPE_CHECKING:
    from collections.abc import Iterator

    from egp_service.control.step import Step

KEY = "5e" * 32


@contextmanager
def stranger(folder: Path, mode: str, name: str, listen: str, connect: str) -> Iterator[None]:
    script = str(Path(__file__).with_name("stranger.py"))
    with program(script, mode, name, listen, connect, folder=folder):
        yield


def is_forged(step: Step) -> bool:
    """Whether the plan of a step is a stranger's, whose plans all steer with 0.0123 rad/s."""
    return step.plan_u is not None and bool(np.all(step.plan_u[:, 1] == 0.0123))


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    file = tmp_path / "vehicles.keys"
    file.write_text(f"default/car-1 {KEY}\ndefault/car-2 {'77' * 32}\n", encoding="utf-8")
    return file


def test_a_drive_without_its_key_does_not_start(tmp_path: Path) -> None:
    keys = tmp_path / "vehicles.keys"
    keys.write_text(f"depot/car-1 {KEY}\n", encoding="utf-8")
    scenario = tmp_path / "short.toml"
    scenario.write_text(
        'name = "short"\nlaps = 0.3\n[track]\nkind = "circle"\n'
        "[[zones]]\nstart = 0.0\nfriction = 1.0\n"
    )
    endpoint = free_endpoint()
    command = ["drive", "-s", str(scenario), "--no-pictures", "--connect", endpoint]
    command += ["--vehicle", "depot/car-1"]
    with service(tmp_path, endpoint, f'vehicle_keys = "{keys}"'):
        for name, key in (("with", ["--key", str(keys)]), ("without", [])):
            output = tmp_path / name
            done = CliRunner().invoke(app, [*command, *key, "-o", str(output)])
            assert done.exit_code == (0 if key else 1), done.output
            assert len(list(output.glob("*/summary.json"))) == (1 if key else 0)
    told = "replica main: it answers only vehicles with a secret key; give the client the key"
    assert told in str(done.exception)


@pytest.mark.parametrize("mode", ["forge", "replay", "swap"])
def test_a_stranger_at_a_replicas_key_is_believed_without_a_key_only(
    tmp_path: Path, keys: Path, mode: str
) -> None:
    """The stranger answers for `main`, itself with the help of the service where it needs that."""
    behind, front = free_endpoint(), free_endpoint()
    line = f'vehicle_keys = "{keys}"'
    with service(tmp_path, behind, line), stranger(tmp_path, mode, "main", front, behind):
        with VehicleClient.connect(
            [front], vehicle="car-1", gate=GATE, key_file=keys, timeout=PATIENCE
        ) as vehicle:
            steps = drive(vehicle)
        assert not any(is_forged(step) for step in steps)
        used = [step for step in steps if step.status == "solved"]
        # A stranger that replays or swaps passes on the first answers, which are genuine.
        assert len(used) == (0 if mode == "forge" else 3)
        assert {step.status for step in steps} <= {"solved", "unusable", "unreachable"}
    if mode == "forge":
        with (
            stranger(tmp_path, mode, "main", front, behind),
            service(tmp_path, behind),
            VehicleClient.connect([front], gate=GATE, timeout=PATIENCE) as vehicle,
        ):
            assert all(is_forged(step) for step in drive(vehicle))


def test_a_stray_replica_costs_a_vehicle_with_a_key_no_plan(tmp_path: Path, keys: Path) -> None:
    """It announces itself beside the service, under names of which some rank before `main`."""
    order = Discovery(fleet="default", vehicle="car-1", gate=GATE)
    for name in ("main", "stray-0", "stray-1", "stray-2"):
        order.replica_appeared(name)
    question = order.next_question()
    assert question is not None
    assert question[0] != "main"
    with ExitStack() as running:
        endpoints = [free_endpoint() for _ in range(4)]
        running.enter_context(service(tmp_path, endpoints[0], f'vehicle_keys = "{keys}"'))
        for number, endpoint in enumerate(endpoints[1:]):
            name = f"stray-{number}"
            running.enter_context(stranger(tmp_path, "forge", name, endpoint, endpoints[0]))
        with VehicleClient.connect(
            endpoints, vehicle="car-1", gate=GATE, key_file=keys, timeout=PATIENCE
        ) as vehicle:
            wait_for_replicas(vehicle, len(endpoints))
            steps = drive(vehicle)
        assert not any(is_forged(step) for step in steps)
        assert sum(step.status == "solved" for step in steps) >= STEPS - 1
        assert np.median([step.timings.total for step in steps]) < 0.5
        assert {step.replica for step in steps if step.status == "solved"} == {"main"}


def test_a_request_is_sealed_as_the_wire_document_says(tmp_path: Path, keys: Path) -> None:
    """Another implementation of the tags: Python's `hmac`."""
    endpoint, key = free_endpoint(), bytes.fromhex(KEY)
    question = "egp/v1/r/main/ready"
    label = b"egp.v1 question\0" + question.encode() + b"\0" + struct.pack("<QQ", 5, 6)
    tag = hmac.digest(key, label, hashlib.sha256)
    seal = b"\x0a\x07default\x12\x05car-1\x18\x05\x20\x06\x2a\x20" + tag
    with service(tmp_path, endpoint, f'vehicle_keys = "{keys}"'), client(endpoint) as session:
        reply = first(session, question, attachment=seal)
        assert reply is not None
        expected = hmac.digest(key, b"egp.v1 answer\0" + tag + reply.payload.to_bytes(), "sha256")
        assert reply.attachment is not None
        assert reply.attachment.to_bytes() == b"\x1a\x20" + expected
        anonymous = first(session, question)
        assert anonymous is not None
        assert anonymous.attachment is None


def test_a_signature_of_the_command_is_accepted_and_a_strangers_is_not(tmp_path: Path) -> None:
    pytest.importorskip("cryptography", reason="the extra `security` is not installed")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    for folder in ("own", "foreign"):
        write_credentials(tmp_path / folder, "f", ["a"], hosts=["h"], port=7447, days=1)
    library = tmp_path / "library.safetensors"
    shutil.copyfile(LIBRARY, library)
    listen = f'[zenoh]\n"listen/endpoints" = \'["{free_endpoint()}"]\'\n'
    keys = tmp_path / "own" / "library.pub"
    config = f'library = "{library}"\nlibrary_keys = "{keys}"\nworkers = 1\n{listen}'
    with pytest.raises(EgpError, match="`egp sign` writes the signature"):
        Server(config)
    for folder in ("foreign", "own"):
        key = str(tmp_path / folder / "library.key")
        result = CliRunner().invoke(app, ["sign", str(library), "--key", key])
        assert result.exit_code == 0, result.output
        if folder == "foreign":
            with pytest.raises(EgpError, match="is not signed by any of the 1 configured keys"):
                Server(config)
    Server(config).stop()
    certificate = tmp_path / "own" / "ca.key"
    with pytest.raises(EgpError, match="expected an Ed25519 key"):
        sign_library(library, certificate)


def test_a_connection_that_says_nothing_is_closed(tmp_path: Path) -> None:
    """It would keep one of the places that zenoh has for connections that become sessions."""
    endpoint = free_endpoint()
    host, _, port = endpoint.rpartition("/")[2].partition(":")
    with service(tmp_path, endpoint), client(endpoint) as session:
        assert first(session, "egp/v1/r/main/health") is not None
        with socket.create_connection((host, int(port))) as silent:
            # Closed after 2 s; zenoh's own default is 10 s.
            silent.settimeout(8.0)
            assert silent.recv(1) == b""
