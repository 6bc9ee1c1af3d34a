"""What each identity may do: the table of docs/security.md against zenoh, over mutual TLS."""

from __future__ import annotations

import json
import re
import time
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pytest
import zenoh
from security_programs import secrets

from egp_service.control.endpoints import free_endpoint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

TABLE: Final = Path(__file__).parents[2] / "docs" / "security.md"
OPERATIONS: Final = ("query", "answer", "put", "subscribe", "announce", "follow")
IDENTITIES: Final = ("service", "map", "f/a", "f/b", "operator", "stranger")
# What is allowed arrives within a tenth of the first time; a link is there within the second.
SETTLE_SECONDS, PATIENCE = 0.1, 10.0
# A right: an identity, an operation and a key.
Right = tuple[str, str, str]


def documented() -> tuple[list[str], set[Right]]:
    """Read the keys and the rights from the table."""
    keys, rights = [], set()
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        if not line.startswith("| ") or "egp/v1/" not in line:
            continue
        row = re.fullmatch(r"\| `(egp/v1/[^`]+)` \|(.*)\|", line)
        assert row is not None, line
        keys.append(row[1])
        cells = [cell.strip() for cell in row[2].split("|")]
        for identity, cell in zip(IDENTITIES, cells, strict=True):
            found = set() if cell == "-" else set(cell.split(", "))
            assert found <= set(OPERATIONS), line
            rights |= {(identity, operation, row[1]) for operation in found}
    assert {identity for identity, _, _ in rights} == {*IDENTITIES} - {"stranger"}
    return keys, rights


KEYS, RIGHTS = documented()


def at(hub: str, rights: Iterable[Right]) -> set[Right]:
    """Give the rights that hold where the hub is the service, the map service or a router."""
    if hub == "router":
        return set(rights)
    of_the_map = ("egp/v1/map/", "egp/v1/@map/")
    between_services = "egp/v1/r/main/library/"
    return {
        right
        for right in rights
        if right[2].startswith(of_the_map) == (hub == "map")
        and (
            right[0] not in {"service", "map"}
            or (right[0] == hub == "service" and right[2].startswith(between_services))
        )
    }


class Matrix:
    """Sessions of all identities with one hub, whose own session sees what they do.

    zenoh's access control is applied to links, and not to what a program does itself: the session
    of the hub may do everything.
    """

    def __init__(
        self, hub: zenoh.Session, sessions: dict[str, zenoh.Session], expected: set[Right]
    ) -> None:
        self.hub = hub
        self.sessions = sessions
        self.expected = expected
        self.found: set[Right] = set()

    def observe(self) -> set[Right]:
        """Try each operation of each identity on each key."""
        self._query()
        self._answer()
        self._put()
        self._subscribe()
        self._announce()
        self._follow()
        return self.found

    def _repeat(self, attempt: Callable[[], None], operation: str, *identities: str) -> None:
        """Repeat an attempt until the expected rights were seen, and once more for others."""
        expected = {
            right
            for right in self.expected
            if right[1] == operation and right[0] in (identities or IDENTITIES)
        }
        late = time.monotonic() + PATIENCE
        while not expected <= self.found and time.monotonic() < late:
            attempt()
            time.sleep(SETTLE_SECONDS)
        attempt()
        time.sleep(SETTLE_SECONDS)

    def _note(self, identity: str, operation: str, key: str) -> Callable[[object], None]:
        return lambda _: self.found.add((identity, operation, key))

    def _query(self) -> None:
        declared = [self.hub.declare_queryable(key, reply_with("hub")) for key in KEYS]

        def attempt() -> None:
            for (identity, session), key in product(self.sessions.items(), KEYS):
                session.get(key, answered(self._note(identity, "query", key)), timeout=1.0)

        self._repeat(attempt, "query")
        undeclare(declared)

    def _answer(self) -> None:
        declared = [
            session.declare_queryable(key, reply_with(identity))
            for (identity, session), key in product(self.sessions.items(), KEYS)
        ]

        def attempt() -> None:
            for key in KEYS:
                self.hub.get(key, note, target=zenoh.QueryTarget.ALL, timeout=1.0)

        def note(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                identity, key = reply.ok.payload.to_string(), str(reply.ok.key_expr)
                self.found.add((identity, "answer", key))

        self._repeat(attempt, "answer")
        undeclare(declared)

    def _put(self) -> None:
        def note(sample: zenoh.Sample) -> None:
            identity = sample.payload.to_string() or "deletion"
            self.found.add((identity, "put", str(sample.key_expr)))

        def attempt() -> None:
            for (identity, session), key in product(self.sessions.items(), KEYS):
                session.put(key, identity.encode())
                session.delete(key)  # no identity may

        declared = [self.hub.declare_subscriber(key, note) for key in KEYS]
        self._repeat(attempt, "put")
        undeclare(declared)

    def _subscribe(self) -> None:
        declared = [
            session.declare_subscriber(key, self._note(identity, "subscribe", key))
            for (identity, session), key in product(self.sessions.items(), KEYS)
        ]

        def attempt() -> None:
            for key in KEYS:
                self.hub.put(key, b"hub")

        self._repeat(attempt, "subscribe")
        undeclare(declared)

    def _announce(self) -> None:
        for identity, session in self.sessions.items():
            tokens = [session.liveliness().declare_token(key) for key in KEYS]

            def attempt(identity: str = identity) -> None:
                self.found |= {(identity, "announce", key) for key in KEYS if alive(self.hub, key)}

            self._repeat(attempt, "announce", identity)
            undeclare(tokens)
            late = time.monotonic() + PATIENCE
            while any(alive(self.hub, key) for key in KEYS):
                assert time.monotonic() < late

    def _follow(self) -> None:
        tokens = [self.hub.liveliness().declare_token(key) for key in KEYS]
        declared = [
            session.liveliness().declare_subscriber(
                key, self._note(identity, "follow", key), history=True
            )
            for (identity, session), key in product(self.sessions.items(), KEYS)
        ]

        def attempt() -> None:
            for (identity, session), key in product(self.sessions.items(), KEYS):
                note = answered(self._note(identity, "follow", key))
                session.liveliness().get(key, note, timeout=1.0)

        self._repeat(attempt, "follow")
        undeclare([*declared, *tokens])


def reply_with(name: str) -> Callable[[zenoh.Query], None]:
    return lambda query: query.reply(query.key_expr, name.encode())


def answered(note: Callable[[object], None]) -> Callable[[zenoh.Reply], None]:
    """Leave out the errors with which zenoh ends a query."""
    return lambda reply: note(reply) if reply.ok is not None else None


def alive(session: zenoh.Session, key: str) -> bool:
    return any(reply.ok is not None for reply in session.liveliness().get(key, timeout=1.0))


def undeclare(
    declared: Iterable[zenoh.Queryable[None] | zenoh.Subscriber[None] | zenoh.LivelinessToken],
) -> None:
    for one in declared:
        one.undeclare()  # type: ignore[no-untyped-call]


def opened(file: Path, **settings: object) -> zenoh.Session:
    config = zenoh.Config.from_file(file)
    for key, value in settings.items():
        config.insert_json5(key.replace("__", "/"), json.dumps(value))
    return zenoh.open(config)


@pytest.mark.parametrize("own_rules", [False, True], ids=["rogue", "own rules"])
@pytest.mark.parametrize("hub", ["router", "service", "map"])
def test_each_identity_has_the_rights_of_the_table(
    tmp_path: Path, hub: str, *, own_rules: bool
) -> None:
    """A rogue has the certificate of its identity, but not the rules that came with it."""
    endpoint = free_endpoint("tls")
    own, foreign = secrets(tmp_path / "own", endpoint), secrets(tmp_path / "foreign", endpoint)
    files = {name: own / f"{name}.json5" for name in ("service", "map", "operator")}
    files |= {f"f/{name}": own / "vehicles" / f"f@{name}.json5" for name in ("a", "b")}
    files["stranger"] = foreign / "vehicles" / "f@a.json5"
    with ExitStack() as running:
        listening = opened(own / f"{hub}.json5", listen__endpoints=[endpoint])
        running.enter_context(listening)
        sessions = {
            name: running.enter_context(
                opened(
                    file,
                    # A client sends all that it has to the hub. Without a link there is no client.
                    mode="peer" if name == "stranger" else "client",
                    listen__endpoints=[],
                    connect__endpoints=[endpoint],
                    connect__timeout_ms=1000,
                    connect__exit_on_failure=False,
                    access_control__enabled=own_rules,
                )
            )
            for name, file in files.items()
        }
        expected = at(hub, RIGHTS)
        assert Matrix(listening, sessions, expected).observe() == expected
