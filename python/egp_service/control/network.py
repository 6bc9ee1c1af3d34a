"""A zenoh session to the replicas of the service, whose events become calls of a driver."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

import zenoh

from egp_service._core import LIVE_KEYS, EgpError, replica_of_live
from egp_service.control.endpoints import endpoint_names, why_unreachable
from egp_service.control.inbox import Inbox
from egp_service.control.session import (
    close_session,
    direct,
    look_again,
    open_session,
    zenoh_reason,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from egp_service._core import Driver, Query

REQUEST_ENCODING = "application/protobuf;egp.v1.StepRequest"
_NO_LINK = (
    "there is no link to a service: no program of zenoh listens, or, with TLS, a certificate is "
    "missing, has expired or is of another authority"
)


class ServiceUnreachableError(EgpError):
    """No replica of the service gave a usable answer."""

    replicas: Mapping[str, str] = MappingProxyType({})
    """The replicas that announced themselves, each with the reason why it cannot be used."""


@dataclass(frozen=True, slots=True)
class Announcement:
    """A replica that announces itself or, if `appeared` is false, no longer does."""

    at: float
    replica: str
    appeared: bool

    def __call__(self, driver: Driver) -> None:
        """Call `replica_appeared` or `replica_gone` of the driver."""
        if self.appeared:
            driver.replica_appeared(self.replica)
        else:
            driver.replica_gone(self.at, self.replica)


@dataclass(frozen=True, slots=True)
class _Silence:
    """No answer to the question whether a replica that was lost is there."""

    replica: str

    def __call__(self, driver: Driver) -> None:
        """Call nothing of the driver; `Network.next` repeats the question."""


class Network:
    """A zenoh session, and its events in order as calls of a driver."""

    def __init__(self, config: zenoh.Config, endpoints: Sequence[str], patience: float) -> None:
        """Open the session and follow the replicas that announce themselves.

        `endpoints` are those that an error names; `patience` is that of `open_session`.
        """
        self._inbox: Inbox[Callable[[Driver], None]] = Inbox()
        try:
            self.session = open_session(config, patience)
        except zenoh.ZError as error:
            raise unreachable(
                endpoints, f"zenoh cannot open a session ({zenoh_reason(error)})"
            ) from error
        self._on_token = _announcing(self._inbox)
        self._subscriber = self.session.liveliness().declare_subscriber(
            LIVE_KEYS, direct(self._on_token), history=True
        )

    def next(self, patience: float) -> Callable[[Driver], None] | None:
        """Return the next event, or None if there is none within `patience` seconds.

        After the loss of a replica this also asks whether it is there, until there is an answer.
        """
        event = self._inbox.get(patience)
        if isinstance(event, _Silence) or (isinstance(event, Announcement) and not event.appeared):
            self._look_again(event.replica)
        return event

    def _look_again(self, replica: str) -> None:
        key = LIVE_KEYS.replace("*", replica)
        # zenoh calls `silence` in its own thread if no answer came in time. It only adds an event,
        # so that the thread that handles events repeats the question.
        silence = partial(self._inbox.put, _Silence(replica))
        look_again(self.session, key, self._on_token, silence)

    def ask(self, query: Query) -> None:
        """Send a query, whose answers become events; one that cannot be sent ends immediately."""
        # zenoh keeps the functions until the query ends, and so they do not hold the network.
        inbox = self._inbox

        def deliver(reply: zenoh.Reply) -> None:
            now, sample, error = time.monotonic(), reply.ok, reply.err
            if sample is not None:
                attachment = sample.attachment
                extra = b"" if attachment is None else attachment.to_bytes()
                payload = sample.payload.to_bytes()
                inbox.put(lambda driver: driver.replied(now, query.id, payload, extra))
            elif error is not None:
                payload = error.payload.to_bytes()
                inbox.put(lambda driver: driver.refused(now, query.id, payload))

        def end() -> None:
            now = time.monotonic()
            inbox.put(lambda driver: driver.ended(now, query.id))

        try:
            self.session.get(
                query.key,
                direct(deliver, end),
                payload=query.payload,
                attachment=query.attachment or None,
                encoding=REQUEST_ENCODING,
                timeout=query.listen,
                # zenoh would wait for up to five seconds while a link to a silent replica is full.
                congestion_control=zenoh.CongestionControl.DROP,
                # By default zenoh keeps a reply until all copies of the question have ended.
                consolidation=zenoh.ConsolidationMode.NONE,
            )
        except zenoh.ZError:
            end()

    def ask_and_wait(
        self, key: str, attachment: bytes, patience: float
    ) -> Iterator[tuple[bytes, bytes]]:
        """Give payload and attachment of each answer that comes within `patience` seconds."""
        for reply in self.session.get(
            key,
            attachment=attachment or None,
            timeout=patience,
            consolidation=zenoh.ConsolidationMode.NONE,
        ):
            if reply.ok is not None:
                extra = reply.ok.attachment
                yield reply.ok.payload.to_bytes(), b"" if extra is None else extra.to_bytes()

    def has_link(self) -> bool:
        """Tell whether the session has a link to another one."""
        info = self.session.info
        return bool(info.peers_zid() or info.routers_zid())

    def close(self) -> None:
        """Close the session."""
        close_session(self.session)


def _announcing(inbox: Inbox[Callable[[Driver], None]]) -> Callable[[zenoh.Sample], None]:
    """Return a function that makes an event of a liveliness token.

    zenoh keeps it as long as the session. It does not hold the network, so that one that is no
    longer used is collected, which closes its session.
    """

    def on_token(sample: zenoh.Sample) -> None:
        replica = replica_of_live(str(sample.key_expr))
        if replica is None:
            return
        appeared = sample.kind == zenoh.SampleKind.PUT
        inbox.put(Announcement(time.monotonic(), replica, appeared))

    return on_token


def no_link(endpoints: Sequence[str]) -> str:
    """Say why there is no link: what the system says of each endpoint, if it says something."""
    found = [(endpoint, why_unreachable(endpoint)) for endpoint in endpoints]
    reasons = [f"{endpoint}: {reason}" for endpoint, reason in found if reason is not None]
    return f"there is no link to a service ({'; '.join(reasons)})" if reasons else _NO_LINK


def unreachable(endpoints: Sequence[str], reason: str) -> ServiceUnreachableError:
    """Return the error of a client that found no usable service at these endpoints."""
    return ServiceUnreachableError(
        f"{reason}; looked at {endpoint_names(endpoints)}; "
        "start a replica with `egp serve LIBRARY --listen ENDPOINT` or check the address"
    )
