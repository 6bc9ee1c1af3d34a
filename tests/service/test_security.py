"""A vehicle with a secret key drives no plan that its service did not make, and strangers get none.

Service, vehicle and strangers are zenoh sessions in processes of their own.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import shutil
import socket
import struct
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import zenoh
from typer.testing import CliRunner

from egp_service import EgpError, VehicleClient
from egp_service._core import Discovery, Server
from egp_service._core.testing import live_key
from egp_service.cli import app
from egp_service.cli.signing import sign_library
from egp_service.simulation.scenario import gate_settings, library_path, load_scenario

if TYPE_CHECKING:
    from collections.abc import Iterator

    from egp_service.control.step import Step

SCENARIO = load_scenario("rounded-rectangle")
LIBRARY = library_path(SCENARIO)
GATE = gate_settings(SCENARIO)
KEY = "5e" * 32
PATIENCE = 30.0
STEPS = 25
# A link that is allowed is there within a tenth of this.
LINK_SECONDS = 1.5


def free_endpoint(protocol: str = "tcp") -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"{protocol}/127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def program(*command: str, folder: Path) -> Iterator[None]:
    """Run a program until the end of the block."""
    with (folder / "log.txt").open("a") as log:
        process = subprocess.Popen([sys.executable, *command], stdout=log, stderr=log)
    try:
        yield
    finally:
        process.kill()
        process.wait()


@contextmanager
def service(folder: Path, endpoint: str, *lines: str) -> Iterator[None]:
    """Run `egp serve`, as the replica `main`, with these lines of configuration."""
    listen = f'[zenoh]\n"listen/endpoints" = \'["{endpoint}"]\'\n'
    config = folder / "service.toml"
    config.write_text("\n".join([f'library = "{LIBRARY}"', *lines, listen]), encoding="utf-8")
    with program("-m", "egp_service", "serve", "--config", str(config), folder=folder):
        yield


@contextmanager
def stranger(folder: Path, mode: str, name: str, listen: str, connect: str) -> Iterator[None]:
    script = str(Path(__file__).with_name("stranger.py"))
    with program(script, mode, name, listen, connect, folder=folder):
        yield


def drive(vehicle: VehicleClient) -> list[Step]:
    """Drive straight on, with the same measurement in each period."""
    s = 15.0 * vehicle.dt * np.arange(vehicle.horizon + 1)
    zero = np.zeros_like(s)
    reference = np.column_stack([s, zero, zero + 15.0, zero])
    x = np.array([0.0, 0.3, 15.0, 0.0, 0.0, 0.0, 0.0])
    steps = []
    for _ in range(STEPS):
        steps.append(vehicle.step(x, reference, deadline=0.5))
        if steps[-1].mode == "stop":
            vehicle.reset()
    return steps


def is_forged(step: Step) -> bool:
    """Whether the plan of a step is a stranger's, whose plans all steer with 0.0123 rad/s."""
    return step.plan_u is not None and bool(np.all(step.plan_u[:, 1] == 0.0123))


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    file = tmp_path / "vehicles.keys"
    file.write_text(f"default/car-1 {KEY}\ndefault/car-2 {'77' * 32}\n", encoding="utf-8")
    return file


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
            time.sleep(1.0)  # the strays are known
            steps = drive(vehicle)
        assert not any(is_forged(step) for step in steps)
        assert sum(step.status == "solved" for step in steps) >= STEPS - 1
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


@contextmanager
def client(endpoint: str, file: Path | None = None) -> Iterator[zenoh.Session]:
    config = zenoh.Config() if file is None else zenoh.Config.from_file(file)
    for key, value in (
        ("connect/endpoints", [endpoint]),
        ("connect/timeout_ms", 3000),
        ("connect/exit_on_failure", False),
        ("listen/endpoints", []),
        ("scouting/multicast/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield session


def first(session: zenoh.Session, key: str, attachment: bytes | None = None) -> zenoh.Sample | None:
    """Ask until there is an answer, because the link may not be there yet."""
    end = time.monotonic() + LINK_SECONDS
    while time.monotonic() < end:
        for reply in session.get(key, attachment=attachment, timeout=2.0):
            if reply.ok is not None:
                return reply.ok
        time.sleep(0.05)
    return None


def answered(session: zenoh.Session, key: str) -> bool:
    """Whether the service answers at all, by a reply or an error."""
    return any(True for _ in session.get(key, payload=b"noise", timeout=2.0))


def forge(query: zenoh.Query) -> None:
    query.reply(query.key_expr, b"forged")


def test_certificates_give_each_identity_its_own_keys(tmp_path: Path) -> None:
    pytest.importorskip("cryptography", reason="the extra `security` is not installed")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    endpoint = free_endpoint("tls")
    port = int(endpoint.rpartition(":")[2])
    folders = {name: tmp_path / name for name in ("own", "foreign")}
    for folder in folders.values():
        write_credentials(folder, "f", ["a"], hosts=["127.0.0.1"], port=port, days=1)
    own = folders["own"]
    assert write_credentials(own, "f", ["a", "b"], hosts=["127.0.0.1"], port=port, days=1) == [
        "f/b"
    ]
    files = {
        "a": own / "vehicles" / "f@a.json5",
        "b": own / "vehicles" / "f@b.json5",
        "operator": own / "operator.json5",
        "foreign vehicle": folders["foreign"] / "vehicles" / "f@a.json5",
        "foreign operator": folders["foreign"] / "operator.json5",
        "nobody": None,
    }
    root = "egp/v1/r/main"
    keys = {
        "step of a": f"{root}/f/a/step",
        "step of b": f"{root}/f/b/step",
        "ready": f"{root}/ready",
        "health": f"{root}/health",
        "metrics": f"{root}/metrics",
    }
    allowed = {
        "a": {"step of a", "ready"},
        "b": {"step of b", "ready"},
        "operator": {"ready", "health", "metrics"},
    }
    config = f'zenoh_file = "{own / "service.json5"}"'
    with service(tmp_path, endpoint, config):
        for name, file in files.items():
            with client(endpoint, file) as session:
                linked = name in allowed
                assert (first(session, keys["ready"]) is not None) == linked, name
                for what, key in keys.items():
                    assert answered(session, key) == (what in allowed.get(name, ())), (name, what)
                tokens = [reply.ok for reply in session.liveliness().get("egp/v1/@live/*")]
                assert bool(tokens) == linked, name
        with client(endpoint, files["b"]) as rogue, client(endpoint, files["a"]) as session:
            # A vehicle can neither announce a replica nor answer for one.
            queryable = rogue.declare_queryable("egp/v1/r/**", forge, complete=True)
            token = rogue.liveliness().declare_token(live_key("stray"))
            for _ in range(20):
                reply = first(session, keys["ready"])
                assert reply is not None
                assert reply.payload.to_bytes() != b"forged"
            seen = [str(r.ok.key_expr) for r in session.liveliness().get("egp/v1/@live/*") if r.ok]
            assert seen == [live_key("main")]
            del queryable, token


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
