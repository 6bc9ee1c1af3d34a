"""Exchange of what vehicles measured about a road's friction, with a map service over zenoh."""

from __future__ import annotations

import logging
import math
import time
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Self

import zenoh

from egp_service._core import (
    EgpError,
    InvalidArgumentError,
    RoadKey,
    decode_error,
    decode_road_tiles,
    decode_tiles_changed,
    encode_tile_evidence,
    merge_tiles,
)
from egp_service.control.inbox import Inbox
from egp_service.control.session import direct, open_session, session_config, zenoh_reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from egp_service._core import Refusal, RoadBelief

EVIDENCE_ENCODING = "application/protobuf;egp.v1.TileEvidence"
# Time between two exchanges, and after which reports are aged again while the service is silent, s.
_EXCHANGE_SECONDS = 1.0
_AGEING_SECONDS = 60.0
# Part of `timeout` that the first question for tiles may take, so that a lost answer is asked for
# again. Later ones may take all of it, as the answers on a slow link do.
_FIRST_SHARE = 1.0 / 3.0
# The largest age of evidence that its message can state in 32 bits of ms, s.
_OLDEST = 4_294_967.0
# Above the largest ratio of likelihoods that a tile can hold, nats.
_UNLIMITED = 8.0
# Largest number of tiles whose evidence is being sent: a slow link has room for little.
_SENDING = 16

_NO_ANSWER = "no map service answers; driving goes on without it"

_log = logging.getLogger(__name__)


@dataclass
class _Report:
    """A tile as the map service answered it."""

    tile: bytes
    at: float
    aged: float
    origins: dict[str, float] = field(default_factory=dict)


class FleetMap:
    """What the other vehicles of a fleet measured about one road; a context manager.

    `exchange` is called by the thread that uses the belief, once in each control period. It never
    waits: answers of the service arrive in the background and are used when they are there. On
    leaving, the last evidence is sent, for which the manager waits up to `timeout` s.
    """

    def __init__(
        self,
        endpoint: str,
        belief: RoadBelief,
        *,
        road: str,
        vehicle: str,
        fleet: str = "default",
        lifetime: float = 1800.0,
        timeout: float = 3.0,
        zenoh_file: Path | None = None,
        zenoh_config: Mapping[str, object] | None = None,
    ) -> None:
        """Connect to the map service at `endpoint`, such as `tcp/127.0.0.1:7448`.

        All vehicles of a fleet name a road alike; `vehicle` must be unique in the fleet.
        `lifetime`, s, is that of the service: reports age while it is silent. `timeout`, s, limits
        the wait for the connection and, on leaving, for the last evidence to be sent. `zenoh_file`
        and `zenoh_config` are as for `VehicleClient.connect`.

        Raises:
            InvalidArgumentError: for names, a configuration or times that cannot be used.
            EgpError: if zenoh opens no session.

        """
        self._keys = RoadKey(fleet, vehicle, road)
        if not 0.0 < lifetime < math.inf:
            raise InvalidArgumentError(
                f"expected a positive number of seconds for lifetime, got {lifetime}"
            )
        self._belief = belief
        self._lifetime = lifetime
        self._timeout = timeout
        self._inbox: Inbox[Callable[[], None]] = Inbox()
        self._reports: dict[int, _Report] = {}
        # Tiles with new evidence, each with the time at which it was noticed. What the belief has
        # from earlier runs is not sent, because its age is not known.
        self._unsent: dict[int, float] = {}
        belief.take_changed()
        self._sending: set[int] = set()
        # The first and the last tile that have changed since they were asked for.
        self._stale: tuple[int, int] | None = None
        self._asking = 0
        self._answered = False
        self._patience = timeout
        self._exchanged = time.monotonic()
        self._warned: set[str] = set()
        # `_silent`: the last question had no answer. `_fetching`: `fetch` is running, which reports
        # a missing answer itself, so that no second warning is logged.
        self._silent = self._fetching = False
        try:
            config = session_config([endpoint], timeout, zenoh_config or {}, zenoh_file)
            self._session = open_session(config, timeout)
        except zenoh.ZError as error:
            raise EgpError(
                f"zenoh cannot open a session with {endpoint}: {zenoh_reason(error)}"
            ) from error
        self._subscriber = self._session.declare_subscriber(
            self._keys.changed, direct(self._on_change)
        )

    def fetch(self) -> bool:
        """Ask for all tiles and wait for them; return whether a map service answered."""
        deadline = time.monotonic() + self._timeout
        self._patience = _FIRST_SHARE * self._timeout
        self._fetching = True
        try:
            while time.monotonic() < deadline:
                self._silent = False
                self._ask(*self._road)
                self._patience = self._timeout
                while self._asking and time.monotonic() < deadline:
                    self._handle(deadline)
                if not self._asking and not self._silent and self._stale is None:
                    return True
                time.sleep(0.05)  # the link may not be there yet
        finally:
            self._fetching = False
        self._silent = True
        _log.info(_NO_ANSWER)
        return False

    def exchange(self) -> None:
        """Use what has arrived, and once a second send what changed; returns at once."""
        while (event := self._inbox.get(0.0)) is not None:
            event()
        now = time.monotonic()
        if now - self._exchanged >= _EXCHANGE_SECONDS:
            self._exchanged = now
            self._send()
            if self._stale is not None and not self._asking:
                self._ask(*self._stale)
        # The report that was aged longest ago is the first. Ageing one takes part of a millisecond.
        index, report = next(iter(self._reports.items()), (0, None))
        if report is not None and now - report.aged >= _AGEING_SECONDS:
            report.aged = now
            self._reports[index] = self._reports.pop(index)
            self._belief.report(index, self._at(report, now))

    @property
    def answered(self) -> bool:
        """Whether a map service has answered a question about the road."""
        return self._answered

    @property
    def silent(self) -> bool:
        """Whether no map service replied to the last query, not even with an error."""
        return self._silent

    @property
    def unsent(self) -> int:
        """Number of tiles whose newest evidence no map service has acknowledged."""
        self._note_changed(time.monotonic())
        return len(self._unsent.keys() | self._sending)

    @property
    def origins(self) -> dict[str, float]:
        """The vehicles whose evidence was reported, each with the age of its newest one in s."""
        now, found = time.monotonic(), dict[str, float]()
        for report in self._reports.values():
            for vehicle, age in report.origins.items():
                found[vehicle] = min(found.get(vehicle, float("inf")), age + now - report.at)
        return found

    def close(self) -> None:
        """Send the last evidence and close the session; `unsent` states what could not be sent."""
        deadline = time.monotonic() + self._timeout
        try:
            if not self._silent:
                tried = set[int]()
                self._send(tried)
                while self._sending and time.monotonic() < deadline:
                    self._handle(deadline)
                    self._send(tried)
                if self._sending:
                    self._silent = True
            if left := self.unsent:
                _log.warning("the evidence about %d tiles of the road was not sent", left)
        finally:
            with suppress(zenoh.ZError):  # a link that was cut cannot be closed, and ends by itself
                self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        """Return the map."""
        return self

    def __exit__(self, *_: object) -> None:
        """Send the last evidence and close the session."""
        self.close()

    def _handle(self, deadline: float) -> None:
        """Handle the next event, or wait until the deadline for it."""
        event = self._inbox.get(deadline - time.monotonic())
        if event is not None:
            event()

    def _send(self, tried: set[int] | None = None) -> None:
        """Send tiles whose evidence changed; one without an answer is sent again later.

        Those that were `tried` are not sent.
        """
        now = time.monotonic()
        self._note_changed(now)
        tried = set() if tried is None else tried
        room = _SENDING - len(self._sending)
        for index in sorted(self._unsent.keys() - self._sending - tried)[:room]:
            tried.add(index)
            measured = self._unsent[index]
            evidence = encode_tile_evidence(self._belief.tile(index), now - measured)
            del self._unsent[index]
            self._sending.add(index)
            self._query(
                self._keys.tile(index),
                lambda _: None,
                partial(self._sent, index, measured),
                evidence,
            )

    def _note_changed(self, now: float) -> None:
        self._unsent.update(dict.fromkeys(self._belief.take_changed(), now))
        for index in [i for i, measured in self._unsent.items() if now - measured > _OLDEST]:
            del self._unsent[index]

    def _sent(self, index: int, measured: float, answered: bool) -> None:  # noqa: FBT001 - a callback
        self._sending.discard(index)
        if not answered:
            self._unsent.setdefault(index, measured)

    @property
    def _road(self) -> tuple[int, int]:
        """The first and the last tile of the road."""
        return 0, self._belief.tiles - 1

    def _ask(self, first: int, last: int) -> None:
        """Ask for the tiles from `first` to `last`; an answer may have further ones."""
        self._asking += 1
        if self._stale is not None and first <= self._stale[0] and self._stale[1] <= last:
            self._stale = None
        use = partial(self._use, last)
        self._query(self._keys.tiles(first), use, self._asked, patience=self._patience)

    def _asked(self, answered: bool) -> None:  # noqa: FBT001 - a callback
        self._asking -= 1
        if answered:
            self._answered = True
        else:
            self._stale = self._road

    def _use(self, last: int, payload: bytes) -> None:
        """Hand an answer to the belief, and ask on up to the tile `last`.

        Tiles beyond the end of the road are left out.
        """
        try:
            tiles, more = decode_road_tiles(payload)
        except EgpError as error:
            self._warn(f"an answer of the map service cannot be read: {error}")
            return
        now = time.monotonic()
        for found in tiles:
            if found.index < self._belief.tiles:
                self._belief.report(found.index, found.tile)
                self._reports.pop(found.index, None)
                self._reports[found.index] = _Report(found.tile, now, now, dict(found.origins))
        if more and tiles and tiles[-1].index < last:
            self._ask(tiles[-1].index + 1, last)

    def _at(self, report: _Report, now: float) -> bytes:
        aged = [(report.tile, now - report.at)]
        return merge_tiles(aged, capacity=_UNLIMITED, lifetime=self._lifetime)

    def _query(
        self,
        key: str,
        use: Callable[[bytes], None],
        end: Callable[[bool], None],
        payload: bytes | None = None,
        *,
        patience: float | None = None,
    ) -> None:
        """Send a query whose replies may take `patience` s, by default `timeout`.

        `use` is called with the payload of each reply. When the query has ended, `end` is called:
        with True if it had a reply or an error that is not retryable, otherwise with False. Both
        are called by the thread that calls `exchange`, `fetch` or `close`.
        """
        service_exists = has_final_reply = False
        purpose = "answer questions" if payload is None else "accept evidence"

        def deliver(reply: zenoh.Reply) -> None:
            nonlocal service_exists, has_final_reply
            if reply.ok is not None:
                service_exists = has_final_reply = True
                content = reply.ok.payload.to_bytes()
                self._inbox.put(lambda: use(content))
            elif reply.err is not None:
                content = reply.err.payload.to_bytes()
                with suppress(EgpError):  # such as the text with which zenoh reports a timeout
                    refusal = decode_error(content)
                    service_exists = True
                    has_final_reply = has_final_reply or not refusal.retryable
                    self._inbox.put(lambda: self._refused(purpose, refusal))

        def ended() -> None:
            self._inbox.put(
                partial(
                    self._ended, end, service_exists=service_exists, has_final_reply=has_final_reply
                )
            )

        try:
            self._session.get(
                key,
                direct(deliver, ended),
                payload=payload,
                encoding=EVIDENCE_ENCODING,
                timeout=self._timeout if patience is None else patience,
                congestion_control=zenoh.CongestionControl.DROP,  # BLOCK waits for a full link
            )
        except zenoh.ZError:
            ended()

    def _ended(
        self, end: Callable[[bool], None], *, service_exists: bool, has_final_reply: bool
    ) -> None:
        if not (service_exists or self._silent or self._fetching):
            _log.info(_NO_ANSWER)
        self._silent = not service_exists
        end(has_final_reply)

    def _refused(self, purpose: str, refusal: Refusal) -> None:
        self._warn(f"the map service does not {purpose}: {refusal.code}: {refusal.detail}")

    def _warn(self, text: str) -> None:
        """Log a warning, each only once."""
        if text not in self._warned:
            self._warned.add(text)
            _log.warning(text)

    def _on_change(self, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()

        def note() -> None:
            try:
                changed = decode_tiles_changed(payload)
            except EgpError as error:
                self._warn(f"a publication of the map service cannot be read: {error}")
                return
            if changed:
                both = {*changed, *(self._stale or ())}
                first, last = min(both), min(max(both), self._belief.tiles - 1)
                if first <= last:
                    self._stale = first, last

        self._inbox.put(note)
