"""The control step asked of the service over zenoh."""

from __future__ import annotations

import json
import queue
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import zenoh

from egp_service._core import (
    LIVE_KEYS,
    EgpError,
    decode_error,
    decode_ready,
    decode_timing,
    rank_replicas,
    ready_key,
    replica_of_live,
    step_key,
)
from egp_service.stepper import MICROSECONDS, Answer, Stepper

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from egp_service._core import Ready, Refusal

REQUEST_ENCODING = "application/protobuf;egp.v1.StepRequest"

# A reply later than this and the deadline is of no use to anybody: the plan's tail has ended.
_QUERY_SECONDS = 1.0


class ServiceUnreachableError(EgpError):
    """No replica of the service answered."""


@dataclass(frozen=True, slots=True)
class _Message:
    """What zenoh's thread hands over: a reply, an error, or the end of a query."""

    sequence: int
    replica: str
    kind: str
    payload: bytes = b""
    attachment: bytes = b""
    refusal: Refusal | None = None


class VehicleClient(Stepper):
    """Drive with the service; make one with `VehicleClient.connect`.

    Asks the replica that a rendezvous hash of the vehicle prefers among those alive, and the
    next one when nobody is there. A missing answer costs at most the deadline of the step, then the
    gate takes over; when the service returns it is found again by itself, and `reset()` drives on.
    """

    def __init__(
        self,
        session: zenoh.Session,
        replicas: Replicas,
        ready: Ready,
        *,
        fleet: str,
        vehicle: str,
        gate: Mapping[str, float],
        want_sigma: bool = False,
    ) -> None:
        """Take over an open session; `ready` is what a replica said about its library."""
        super().__init__(
            library=ready.library,
            dt=ready.dt,
            horizon=ready.horizon,
            history=ready.history,
            members=ready.members,
            gate=gate,
            want_sigma=want_sigma,
        )
        self._session = session
        self._replicas = replicas
        self._fleet, self._vehicle = fleet, vehicle
        self._inbox: queue.SimpleQueue[_Message] = queue.SimpleQueue()

    @classmethod
    def connect(
        cls,
        endpoints: Sequence[str],
        *,
        fleet: str = "default",
        vehicle: str = "vehicle-1",
        gate: Mapping[str, float],
        want_sigma: bool = False,
        timeout: float = 10.0,
        zenoh_config: Mapping[str, object] | None = None,
    ) -> Self:
        """Connect to zenoh at `endpoints`, such as `tcp/127.0.0.1:7447`, and ask for the library.

        `gate` holds the limits of the vehicle that is driven, as `VehicleParameters.gate_limits`
        gives them, and may hold `max_tail_ticks` and `stop_deceleration`.
        `zenoh_config` holds more of zenoh's configuration by path, such as
        `{"transport/link/tls/root_ca_certificate": "ca.pem"}`. Raises `ServiceUnreachableError`
        when no replica answers within `timeout` seconds.
        """
        deadline = time.monotonic() + timeout
        try:
            session = zenoh.open(_session_config(endpoints, timeout, zenoh_config or {}))
        except zenoh.ZError as error:
            raise _unreachable(endpoints) from error
        replicas = Replicas(session)
        try:
            ready = _first_ready(session, replicas, endpoints, deadline)
            return cls(
                session,
                replicas,
                ready,
                fleet=fleet,
                vehicle=vehicle,
                gate=gate,
                want_sigma=want_sigma,
            )
        except BaseException:
            session.close()  # type: ignore[no-untyped-call]
            raise

    def close(self) -> None:
        """Close the zenoh session."""
        self._session.close()  # type: ignore[no-untyped-call]

    def _ask(self, request: bytes, sequence: int, deadline: float) -> Answer:
        late: list[bytes] = []
        detail, refused = "no replica of the service is alive", False
        for replica in rank_replicas(self._fleet, self._vehicle, self._replicas.alive()):
            self._send(replica, request, sequence, deadline)
            message = self._await(replica, sequence, deadline, late)
            if message is None:
                detail = f"replica {replica} did not answer in time"
                break
            if message.kind == "reply":
                queue_us, step_us = decode_timing(message.attachment)
                return Answer(
                    message.payload,
                    late=tuple(late),
                    queue=queue_us / MICROSECONDS,
                    compute=step_us / MICROSECONDS,
                    replica=replica,
                )
            if message.refusal is not None:
                error = message.refusal
                detail, refused = f"replica {replica}: {error.code}: {error.detail}", True
                if not error.retryable:
                    break
            else:
                detail = f"replica {replica} is gone"
        return Answer(None, late=tuple(late), detail=detail, refused=refused)

    def _send(self, replica: str, request: bytes, sequence: int, deadline: float) -> None:
        def deliver(reply: zenoh.Reply) -> None:
            sample, error = reply.ok, reply.err
            if sample is not None:
                attachment = sample.attachment
                extra = b"" if attachment is None else attachment.to_bytes()
                payload = sample.payload.to_bytes()
                self._inbox.put(_Message(sequence, replica, "reply", payload, extra))
            elif error is not None:
                # zenoh's own errors, a timeout above all, are silence, like an empty answer.
                with suppress(EgpError):
                    refusal = decode_error(error.payload.to_bytes())
                    self._inbox.put(_Message(sequence, replica, "error", refusal=refusal))

        def end() -> None:
            self._inbox.put(_Message(sequence, replica, "end"))

        self._session.get(
            step_key(replica, self._fleet, self._vehicle),
            zenoh.handlers.Callback(deliver, end, indirect=False),
            payload=request,
            encoding=REQUEST_ENCODING,
            timeout=max(_QUERY_SECONDS, deadline - time.perf_counter()),
        )

    def _await(
        self, replica: str, sequence: int, deadline: float, late: list[bytes]
    ) -> _Message | None:
        """First message about this request; replies to earlier ones go to `late`."""
        while True:
            remaining = deadline - time.perf_counter()
            try:
                message = self._inbox.get(timeout=max(remaining, 0.0))
            except queue.Empty:
                return None
            if message.sequence == sequence and message.replica == replica:
                return message
            if message.kind == "reply":
                late.append(message.payload)


class Replicas:
    """The replicas alive now, by their liveliness tokens."""

    def __init__(self, session: zenoh.Session) -> None:
        """Follow the tokens of `session`, those already there included."""
        self._lock = threading.Lock()
        self._alive: set[str] = set()
        self._subscriber = session.liveliness().declare_subscriber(
            LIVE_KEYS, zenoh.handlers.Callback(self._on_token, indirect=False), history=True
        )

    def alive(self) -> list[str]:
        """Names of the replicas, sorted."""
        with self._lock:
            return sorted(self._alive)

    def _on_token(self, sample: zenoh.Sample) -> None:
        replica = replica_of_live(str(sample.key_expr))
        if replica is None:
            return
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT:
                self._alive.add(replica)
            else:
                self._alive.discard(replica)


def _session_config(
    endpoints: Sequence[str], timeout: float, more: Mapping[str, object]
) -> zenoh.Config:
    """Configure a client that gives up a first connection after `timeout`, and a lost one never.

    No shared memory: it slows the first queries down and can drop one in silence.
    """
    settings: dict[str, object] = {
        "mode": "client",
        "connect/endpoints": list(endpoints),
        "connect/timeout_ms": int(1000 * timeout),
        "connect/retry": {
            "period_init_ms": 50,
            "period_max_ms": 200,
            "period_increase_factor": 2,
        },
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": 2000,
        **more,
    }
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return config


def _first_ready(
    session: zenoh.Session, replicas: Replicas, endpoints: Sequence[str], deadline: float
) -> Ready:
    """Ask until the first replica says what it serves."""
    while time.monotonic() < deadline:
        for replica in replicas.alive():
            replies: Any = session.get(ready_key(replica), timeout=_QUERY_SECONDS)
            for reply in replies:
                if reply.ok is not None:
                    ready = decode_ready(reply.ok.payload.to_bytes())
                    if ready.ready:
                        return ready
        time.sleep(0.02)
    raise _unreachable(endpoints)


def _unreachable(endpoints: Sequence[str]) -> ServiceUnreachableError:
    return ServiceUnreachableError(
        f"no replica of the service answered at {', '.join(endpoints)}; "
        "start one with `egp serve LIBRARY --listen ENDPOINT` or check the address"
    )
