"""Services, routers and the map service with the files of `egp keys`; rogues have certificates."""

from __future__ import annotations

import json
import socket
import time
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import zenoh
from security_programs import (
    GATE,
    LIBRARY,
    LINK_SECONDS,
    PATIENCE,
    client,
    drive,
    first,
    program,
    secrets,
    service,
)

from egp_service import StatusPublisher, VehicleClient
from egp_service._core import RoadBelief, vehicle_key
from egp_service._core.testing import MAP_HEALTH_KEY, live_key
from egp_service.control.endpoints import free_endpoint, why_unreachable
from egp_service.control.fleet_map import FleetMap
from egp_service.monitor.listener import Listener
from egp_service.simulation.course import build_path
from egp_service.simulation.scenario import load_scenario
from patience import wait_until
from road_messages import tiles_key

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

FRICTIONS = 0.1 * 13.0 ** np.linspace(0.0, 1.0, 17)
STRAIGHT = np.array([0.0, 0.3, 15.0, 0.0, 0.0, 0.0, 0.0])


def found(ask: Callable[[], list[Any]], *, expected: bool = True) -> list[Any]:
    """Ask once or, where an answer is expected that a busy machine brings late, until it comes."""
    late = time.monotonic() + (PATIENCE if expected else 0.0)
    while not (answers := ask()) and time.monotonic() < late:
        time.sleep(0.05)
    return answers


def any_answers(session: zenoh.Session, key: str) -> list[zenoh.Reply]:
    """Give the service's answers to noise, errors included."""
    return list(session.get(key, payload=b"noise", timeout=2.0))


def announced(session: zenoh.Session) -> list[str]:
    """Give the keys of the replicas that announce themselves."""
    return [str(r.ok.key_expr) for r in session.liveliness().get("egp/v1/@live/*") if r.ok]


def forge(query: zenoh.Query) -> None:
    query.reply(query.key_expr, b"forged")


def test_a_stranger_who_says_nothing_is_disconnected_soon(tmp_path: Path) -> None:
    pytest.importorskip("cryptography", reason="the extra `security` is not installed")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    endpoint = free_endpoint("tls")
    port = int(endpoint.rpartition(":")[2])
    own = tmp_path / "own"
    write_credentials(own, "f", ["a"], hosts=["127.0.0.1"], port=port, days=1)
    config = tmp_path / "service.toml"
    config.write_text(f'library = "{LIBRARY}"\nzenoh_file = "{own / "service.json5"}"\n')
    with program("-m", "egp_service", "serve", "--config", str(config), folder=tmp_path):
        late = time.monotonic() + PATIENCE
        while why_unreachable(f"tcp/127.0.0.1:{port}") is not None and time.monotonic() < late:
            time.sleep(0.05)
        with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as stranger:
            begun = time.monotonic()
            assert stranger.recv(1) == b""
        # By default zenoh waits for 10 s.
        assert time.monotonic() - begun < 8.0


def test_certificates_give_each_identity_its_own_keys(tmp_path: Path) -> None:
    pytest.importorskip("cryptography", reason="the extra `security` is not installed")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    endpoint = free_endpoint("tls")
    port = int(endpoint.rpartition(":")[2])
    folders = {name: tmp_path / name for name in ("own", "foreign")}
    for folder in folders.values():
        write_credentials(folder, "f", ["a"], hosts=["127.0.0.1"], port=port, days=1)
    own = folders["own"]
    # The service is still reached under the host of the first call.
    both = ["a", "b"]
    assert write_credentials(own, "f", both, hosts=["other.example"], port=port, days=1) == ["f/b"]
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
                ready = first(session, keys["ready"], expected=linked)
                assert (ready is not None) == linked, name
                for what, key in keys.items():
                    may = what in allowed.get(name, ())
                    answers = found(partial(any_answers, session, key), expected=may)
                    assert bool(answers) == may, (name, what)
                seen = found(partial(announced, session), expected=linked)
                assert bool(seen) == linked, name
        with client(endpoint, files["b"]) as rogue, client(endpoint, files["a"]) as session:
            # A vehicle can neither announce a replica nor answer for one.
            queryable = rogue.declare_queryable("egp/v1/r/**", forge, complete=True)
            token = rogue.liveliness().declare_token(live_key("stray"))
            for _ in range(20):
                reply = first(session, keys["ready"])
                assert reply is not None
                assert reply.payload.to_bytes() != b"forged"
            assert found(partial(announced, session)) == [live_key("main")]
            del queryable, token


class Watched:
    """What a monitor hears, in place of its fleet."""

    def __init__(self, monitor: Listener) -> None:
        self.monitor = monitor
        self.vehicles: dict[str, object] = {}
        self.statuses: set[tuple[str, bytes]] = set()
        self.loads: set[tuple[str, bytes]] = set()
        self.tokens: set[str] = set()

    def status(self, name: str, payload: bytes, _: float) -> None:
        """Note a status."""
        self.statuses.add((name, payload))

    def load(self, replica: str, payload: bytes, _: float) -> None:
        """Note a load."""
        self.loads.add((replica, payload))

    def token(self, replica: str, _: float, *, appeared: bool) -> None:
        """Note a replica."""
        assert appeared
        self.tokens.add(replica)

    def hear(self, heard: Callable[[], bool]) -> None:
        """Wait until something was heard."""
        late = time.monotonic() + PATIENCE
        while not heard():
            assert time.monotonic() < late
            self.monitor.deliver(self)  # type: ignore[arg-type]
            time.sleep(0.05)


@contextmanager
def rogue(file: Path, endpoint: str) -> Iterator[zenoh.Session]:
    """Open a session with a certificate, but without the access control that came with it.

    A service or router passes on more for a client than for a peer.
    """
    config = zenoh.Config.from_file(file)
    for key, value in (
        ("mode", "client"),
        ("connect/endpoints", [endpoint]),
        ("connect/timeout_ms", int(1000 * PATIENCE)),
        ("access_control/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield session


@pytest.mark.parametrize("hub", ["service", "router"])
def test_no_certificate_forges_what_services_and_vehicles_publish(tmp_path: Path, hub: str) -> None:
    """The rogues are vehicle b and the operator, at a service or at a router before it."""
    endpoint = free_endpoint("tls")
    own = secrets(tmp_path / "own", endpoint)
    routed = hub == "router"
    vehicle_file = own / "vehicles" / "f@a.json5"
    with ExitStack() as running:
        if routed:
            route = ("-m", "egp_service", "router", "--zenoh", str(own / "router.json5"))
            running.enter_context(program(*route, "--listen", endpoint, folder=tmp_path))
        running.enter_context(
            service(tmp_path, endpoint, f'zenoh_file = "{own / "service.json5"}"', router=routed)
        )
        vehicle = running.enter_context(
            VehicleClient.connect(
                [endpoint],
                fleet="f",
                vehicle="a",
                gate=GATE,
                zenoh_file=str(vehicle_file),
                timeout=PATIENCE,
            )
        )
        steps = drive(vehicle)
        assert sum(step.status == "solved" for step in steps) >= len(steps) - 1
        status = running.enter_context(
            StatusPublisher(vehicle, endpoint, fleet="f", vehicle="a", zenoh_file=str(vehicle_file))
        )
        files = [own / "vehicles" / "f@b.json5", own / "operator.json5"]
        rogues = [running.enter_context(rogue(file, endpoint)) for file in files]
        watched = Watched(running.enter_context(Listener([endpoint], [], own / "monitor.json5")))

        def heard() -> bool:
            for session in rogues:
                session.put(vehicle_key("f", "a"), b"forged")
                session.put("egp/v1/@load/main", b"forged")
            status.add(steps[-1], STRAIGHT, 0.0)
            return bool(watched.statuses and watched.loads and watched.tokens)

        declared = [
            (
                session.declare_queryable("egp/v1/r/**", forge, complete=True),
                session.liveliness().declare_token(live_key("stray")),
            )
            for session in rogues
        ]
        watched.hear(heard)
        for _ in range(10):
            heard()
            time.sleep(0.05)
        watched.monitor.deliver(watched)  # type: ignore[arg-type]
        assert watched.tokens == {"main"}
        assert {name for name, _ in watched.statuses} == {"f/a"}
        assert {name for name, _ in watched.loads} == {"main"}
        assert not any(payload == b"forged" for _, payload in watched.statuses | watched.loads)
        with client(endpoint, vehicle_file) as session:
            reply = first(session, "egp/v1/r/main/ready")
            assert reply is not None
            assert reply.payload.to_bytes() != b"forged"
            assert found(partial(announced, session)) == [live_key("main")]
        del declared


def test_the_map_takes_reports_under_the_name_of_the_certificate_only(tmp_path: Path) -> None:
    endpoint = free_endpoint("tls")
    own = secrets(tmp_path / "own", endpoint)
    config = tmp_path / "map.toml"
    listen = f'"listen/endpoints" = \'["{endpoint}"]\''
    config.write_text(f'zenoh_file = "{own / "map.json5"}"\n[zenoh]\n{listen}\n', encoding="utf-8")
    files = {name: own / "vehicles" / f"f@{name}.json5" for name in ("a", "b")}

    def fleet_map(
        belief: RoadBelief, vehicle: str, file: str, timeout: float = PATIENCE
    ) -> FleetMap:
        return FleetMap(
            endpoint,
            belief,
            road="ring",
            vehicle=vehicle,
            fleet="f",
            timeout=timeout,
            zenoh_file=str(files[file]),
        )

    path = build_path(load_scenario("random"))
    with program("-m", "egp_service", "map", "--config", str(config), folder=tmp_path):
        belief = RoadBelief(path)
        with fleet_map(belief, "a", "a") as honest:
            assert honest.fetch()
            row = -0.5 * (np.log(FRICTIONS / 0.5) / 0.05) ** 2
            for s in np.arange(0.0, 150.0, 0.2):
                belief.update(s, row - row.max())
        with fleet_map(RoadBelief(path), "b", "b") as other:
            assert other.fetch()
            assert set(other.origins) == {"a"}
        with fleet_map(RoadBelief(path), "a", "b", LINK_SECONDS) as forged:
            assert not forged.fetch()
        with client(endpoint, own / "operator.json5") as session:
            assert first(session, MAP_HEALTH_KEY) is not None
            assert first(session, tiles_key("a", fleet="f"), expected=False) is None


def test_the_maps_certificate_does_not_answer_in_a_services_place(tmp_path: Path) -> None:
    """Both are for the same host; the vehicle's own access control tells them apart."""
    endpoint = free_endpoint("tls")
    own = secrets(tmp_path / "own", endpoint)
    believed = {}
    for name in ("service", "map"):
        config = zenoh.Config.from_file(own / f"{name}.json5")
        config.insert_json5("listen/endpoints", json.dumps([endpoint]))
        config.insert_json5("access_control/enabled", "false")
        with (
            zenoh.open(config) as false,
            client(endpoint, own / "vehicles" / "f@a.json5") as session,
        ):
            queryable = false.declare_queryable("egp/v1/r/**", forge, complete=True)
            ready = first(session, "egp/v1/r/main/ready", expected=name == "service")
            believed[name] = ready is not None
            del queryable
    assert believed == {"service": True, "map": False}


def test_a_service_has_a_limited_number_of_sessions(tmp_path: Path) -> None:
    """Two vehicles may have four sessions each, and others sixteen."""
    endpoint = free_endpoint("tls")
    own = secrets(tmp_path / "own", endpoint)
    config = zenoh.Config.from_file(own / "service.json5")
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as hub, ExitStack() as running:
        for _ in range(16 + 2 * 4 + 1):
            running.enter_context(client(endpoint, own / "vehicles" / "f@a.json5"))
        wait_until(lambda: len(hub.info.peers_zid()) >= 24)
        late = time.monotonic() + LINK_SECONDS
        while time.monotonic() < late:
            assert len(hub.info.peers_zid()) <= 24
            time.sleep(0.05)
        assert len(hub.info.peers_zid()) == 24


def test_a_question_that_is_larger_than_any_of_its_key_is_dropped(tmp_path: Path) -> None:
    endpoint = free_endpoint("tls")
    own = secrets(tmp_path / "own", endpoint)
    config = zenoh.Config.from_file(own / "service.json5")
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as hub, client(endpoint, own / "operator.json5") as session:
        key = "egp/v1/r/main/health"
        queryable = hub.declare_queryable("egp/v1/r/main/**", lambda q: q.reply(key, b"ok"))
        assert first(session, key) is not None
        for size, answers in ((1024, True), (1025, False)):

            def ask(size: int = size) -> list[zenoh.Reply]:
                replies = session.get(key, payload=bytes(size), timeout=1.0)
                return [reply for reply in replies if reply.ok is not None]

            assert bool(found(ask, expected=answers)) == answers
        del queryable
