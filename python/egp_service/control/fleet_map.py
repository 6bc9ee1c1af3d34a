"""Exchange of what vehicles measured about a road's friction, with a map service over zenoh."""

from __future__ import annotations

import logging
import time
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Final, Self

import zenoh

from egp_service._core import EgpError, FleetExchange, FleetNotice
from egp_service.control.certificates import check_zenoh_file
from egp_service.control.endpoints import MAP_PORT, endpoint_list, endpoint_names
from egp_service.control.inbox import Inbox
from egp_service.control.session import (
    check_process,
    close_session,
    direct,
    is_lost,
    open_session,
    session_config,
    zenoh_reason,
)
from egp_service.control.step import Closing

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Mapping, Sequence

    from egp_service._core import MapQuery, RoadBelief

_ENCODING: Final = "application/protobuf;egp.v1.TileEvidence"
# Events that one period uses at most: those of a flood wait for the next ones. As many publications
# are kept until the next period.
_EVENTS: Final = 64

_log = logging.getLogger(__name__)


class FleetMap(Closing):
    """What the other vehicles of a fleet measured about one road; a context manager.

    `exchange` is called by the thread that uses the belief, once in each control period. It never
    waits: answers of the service arrive in the background and are used when they are there. On
    leaving, the last evidence is sent, for which the manager waits up to `timeout` s. What is sent,
    asked and used, and when, is decided by the state machine that the Rust client has, too.
    """

    def __init__(
        self,
        endpoints: str | Sequence[str],
        belief: RoadBelief,
        *,
        road: str,
        vehicle: str,
        fleet: str = "default",
        lifetime: float = 1800.0,
        timeout: float = 3.0,
        zenoh_file: str | os.PathLike[str] | None = None,
        zenoh_config: Mapping[str, object] | None = None,
    ) -> None:
        """Connect to the map service at `endpoints`, such as `tcp/127.0.0.1:7448`, or to routers.

        Without `endpoints` those of `zenoh_file` are used.

        All vehicles of a fleet name a road alike; `vehicle` must be unique in the fleet.
        `lifetime`, s, is that of the service: reports age while it is silent. `timeout`, s, limits
        the wait for the connection and, on leaving, for the last evidence to be sent. `zenoh_file`
        and `zenoh_config` are as for `VehicleClient.connect`. What the belief has measured or
        recalled so far is not sent, because its age is not known.

        Raises:
            TypeError: for endpoints or a belief of another type.
            InvalidArgumentError: for endpoints, names, a configuration or times that cannot be
                used, and without endpoints unless there is a configuration.
            EgpError: for certificates as `VehicleClient.connect`, if zenoh opens no session, and in
                a process that was forked from one in which zenoh ran.

        """
        names = endpoint_list(endpoints, MAP_PORT, configured=bool(zenoh_file or zenoh_config))
        config = session_config(names, timeout, zenoh_config or {}, zenoh_file)
        check_zenoh_file(zenoh_file, zenoh_config or {})
        self._exchange = FleetExchange(
            time.monotonic(),
            belief,
            fleet=fleet,
            vehicle=vehicle,
            road=road,
            lifetime=lifetime,
            timeout=timeout,
        )
        self._inbox: Inbox[Callable[[], None]] = Inbox()
        self._publications: deque[bytes | None] = deque(maxlen=_EVENTS)
        self._closed = False
        try:
            self._session = open_session(config, timeout)
        except zenoh.ZError as error:
            raise EgpError(
                f"zenoh cannot open a session with {endpoint_names(names)}: {zenoh_reason(error)}"
            ) from error
        self._subscriber = self._session.declare_subscriber(
            self._exchange.publications, direct(_keeping(self._publications))
        )

    def fetch(self) -> bool:
        """Ask for all tiles and wait for them; return whether a map service answered.

        Raises:
            EgpError: if the map was closed.

        """
        self._check_open()
        self._exchange.fetch(time.monotonic())
        self._wait()
        return not self._exchange.silent

    def exchange(self) -> None:
        """Use what has arrived, and once a second send what changed; returns at once.

        Raises:
            EgpError: if the map was closed.

        """
        self._check_open()
        self._use_publications()
        for _ in range(_EVENTS):
            event = self._inbox.get(0.0)
            if event is None:
                break
            event()
        self._exchange.period(time.monotonic())
        self._carry_out()

    @property
    def answered(self) -> bool:
        """Whether a map service has answered a question about the road."""
        return self._exchange.answered

    @property
    def silent(self) -> bool:
        """Whether no map service replied to the last query, not even with an error."""
        return self._exchange.silent

    @property
    def unsent(self) -> int:
        """Number of tiles whose newest evidence no map service has acknowledged."""
        return self._exchange.unsent(time.monotonic())

    @property
    def origins(self) -> dict[str, float]:
        """The vehicles whose evidence was reported, each with the age of its newest one in s."""
        return self._exchange.origins(time.monotonic())

    def close(self) -> None:
        """Send the last evidence and close the session; `unsent` states what could not be sent."""
        if self._closed:
            return
        self._closed = True
        if is_lost():
            return
        try:
            self._exchange.finish(time.monotonic())
            self._wait()
        finally:
            close_session(self._session)

    def __enter__(self) -> Self:
        """Return the map."""
        self._check_open()
        return self

    def _use_publications(self) -> None:
        for _ in range(len(self._publications)):
            publication = self._publications.popleft()
            if publication is None:
                self._exchange.publications_lost()
            else:
                self._exchange.changed(publication)

    def _check_open(self) -> None:
        if self._closed:
            raise EgpError("the fleet's map was closed: make another FleetMap")
        check_process()

    def _wait(self) -> None:
        """Handle events until the exchange no longer waits for any."""
        self._carry_out()
        while (wake := self._exchange.next_wake) is not None:
            event = self._inbox.get(wake - time.monotonic())
            if event is not None:
                event()
            self._exchange.wake(time.monotonic())  # also while events keep coming
            self._carry_out()

    def _carry_out(self) -> None:
        while (action := self._exchange.next_action()) is not None:
            if isinstance(action, FleetNotice):
                _log.log(logging.WARNING if action.is_warning else logging.INFO, "%s", action.text)
            else:
                self._ask(action)

    def _ask(self, query: MapQuery) -> None:
        """Send a query, whose answers become events. One that cannot be sent has ended."""

        def deliver(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                answer = reply.ok.payload.to_bytes()
                self._inbox.put(lambda: self._exchange.replied(time.monotonic(), query.id, answer))
            elif reply.err is not None:
                error = reply.err.payload.to_bytes()
                self._inbox.put(partial(self._exchange.refused, query.id, error))

        def ended() -> None:
            self._inbox.put(lambda: self._exchange.ended(time.monotonic(), query.id))

        try:
            self._session.get(
                query.key,
                direct(deliver, ended),
                payload=query.payload,
                encoding=_ENCODING,
                timeout=query.listen,
                congestion_control=zenoh.CongestionControl.DROP,  # BLOCK waits for a full link
                consolidation=zenoh.ConsolidationMode.NONE,  # others keep replies until the end
            )
        except zenoh.ZError:
            ended()


def _keeping(publications: deque[bytes | None]) -> Callable[[zenoh.Sample], None]:
    """Return a function that keeps publications of the map, and `None` in place of too many.

    zenoh keeps it as long as the session. It does not hold the `FleetMap`, so that one that is no
    longer used is collected, which closes its session.
    """

    def on_change(sample: zenoh.Sample) -> None:
        full = len(publications) == publications.maxlen  # the oldest one is dropped then
        publications.append(None if full else sample.payload.to_bytes())

    return on_change
