"""The zenoh session of the monitor, and its events in order as calls of a fleet."""

from __future__ import annotations

import logging
import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Final

import zenoh

from egp_service._core import (
    LIVE_KEYS,
    LOAD_KEYS,
    VEHICLE_KEYS,
    EgpError,
    publishing_vehicle,
    replica_of_live,
    replica_of_load,
    vehicle_road_key,
)
from egp_service.control.session import (
    close_session,
    direct,
    look_again,
    open_session,
    session_config,
    zenoh_reason,
)
from egp_service.control.step import Closing
from egp_service.monitor.fleet import LARGEST_ROAD, LARGEST_STATUS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from egp_service.monitor.fleet import Fleet

_CONNECT_SECONDS = 1.0
_ROAD_SECONDS = 2.0
# Bytes of the events that wait for `deliver`, several seconds of 1000 vehicles; further ones are
# dropped. An event without a message counts as `_EVENT`.
_MOST_WAITING: Final = 1 << 27
_EVENT: Final = 1 << 10

_log = logging.getLogger(__name__)


class Listener(Closing):
    """Follows vehicles and replicas; a context manager."""

    def __init__(
        self, connect: Sequence[str], listen: Sequence[str], zenoh_file: Path | None = None
    ) -> None:
        """Connect to services or routers at `connect`, and let vehicles connect to `listen`.

        Endpoints that cannot be reached are tried again and again; in zenoh's mode `client` one of
        them must be reached within a second. `zenoh_file` is a configuration of zenoh in JSON5,
        whose endpoints are replaced by those that are given.

        Raises:
            InvalidArgumentError: for a configuration that cannot be used.
            EgpError: if zenoh opens no session.

        """
        more = {"listen/endpoints": list(listen)} if listen else {}
        self._lock = threading.Lock()
        self._events: list[Callable[[Fleet], None]] = []
        self._waiting = 0
        self.dropped = 0
        """Number of events that found no room."""
        try:
            config = session_config(connect, _CONNECT_SECONDS, more, zenoh_file)
            self._session = open_session(config, _CONNECT_SECONDS)
        except zenoh.ZError as error:
            if "Missing TLS" in str(error):
                hint = "a tls endpoint needs a certificate: give the monitor.json5 of `egp keys`"
            elif listen:
                hint = f"is {', '.join(listen)} in use? Choose another endpoint with --listen"
            else:
                hint = (
                    "a session in zenoh's client mode needs a service or router that runs, and a "
                    "certificate that has not expired"
                )
            raise EgpError(f"zenoh cannot open a session: {zenoh_reason(error)}; {hint}") from error
        self._declared = [
            self._session.declare_subscriber(VEHICLE_KEYS, direct(self._on_vehicle)),
            self._session.declare_subscriber(LOAD_KEYS, direct(self._on_load)),
            self._session.liveliness().declare_subscriber(
                LIVE_KEYS, direct(self._on_token), history=True
            ),
        ]

    def deliver(self, fleet: Fleet) -> None:
        """Tell the fleet what has come since the last call, and ask for missing roads."""
        with self._lock:
            events, self._events, self._waiting = self._events, [], 0
        for event in events:
            event(fleet)
        now = time.monotonic()
        for vehicle in fleet.vehicles.values():
            if vehicle.wants_road(now):
                self._ask_road(vehicle.name)

    def close(self) -> None:
        """Close the session."""
        close_session(self._session)

    def _put(self, event: Callable[[Fleet], None], size: int = 0) -> None:
        """Keep an event with a message of `size` bytes for `deliver`, if there is room."""
        with self._lock:
            kept = self._waiting + _EVENT + size <= _MOST_WAITING
            if kept:
                self._events.append(event)
                self._waiting += _EVENT + size
            else:
                self.dropped += 1
            first = not kept and self.dropped == 1
        if first:
            _log.warning("messages come faster than the monitor reads them; some are dropped")

    def _on_vehicle(self, sample: zenoh.Sample) -> None:
        found = publishing_vehicle(str(sample.key_expr))
        if found is not None and len(sample.payload) <= LARGEST_STATUS:
            now, name, payload = time.monotonic(), "/".join(found), sample.payload.to_bytes()
            self._put(lambda fleet: fleet.status(name, payload, now), len(payload))

    def _on_load(self, sample: zenoh.Sample) -> None:
        replica = replica_of_load(str(sample.key_expr))
        if replica is not None and len(sample.payload) <= LARGEST_STATUS:
            now, payload = time.monotonic(), sample.payload.to_bytes()
            self._put(lambda fleet: fleet.load(replica, payload, now), len(payload))

    def _on_token(self, sample: zenoh.Sample) -> None:
        replica = replica_of_live(str(sample.key_expr))
        if replica is None:
            return
        now, appeared = time.monotonic(), sample.kind == zenoh.SampleKind.PUT

        def note(fleet: Fleet) -> None:
            fleet.token(replica, now, appeared=appeared)
            if not appeared:
                self._look_again(replica)

        self._put(note)

    def _look_again(self, replica: str) -> None:
        key = LIVE_KEYS.replace("*", replica)
        silence = partial(self._put, lambda _: self._look_again(replica))
        look_again(self._session, key, self._on_token, silence)

    def _ask_road(self, name: str) -> None:
        fleet_name, _, vehicle = name.partition("/")

        def deliver(reply: zenoh.Reply) -> None:
            if reply.ok is not None and len(reply.ok.payload) <= LARGEST_ROAD:
                payload = reply.ok.payload.to_bytes()
                self._put(lambda fleet: fleet.road(name, payload), len(payload))

        self._session.get(
            vehicle_road_key(fleet_name, vehicle),
            direct(deliver),
            timeout=_ROAD_SECONDS,
        )
