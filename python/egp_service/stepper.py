"""What every way of asking for a control step shares: the carry, the deadline and the gate.

A stepper turns a measured state and a reference into a command that the actuators may get::

    step = stepper.step(x, reference, widths)
    vehicle.apply(step.u)

`Controller` computes the step in this process, `VehicleClient` asks the service; both send the same
request and get the same bytes back.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, Self

import numpy as np

from egp_service._core import Carry, EgpError, Gate, decode_reply

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType

    from numpy.typing import ArrayLike, NDArray

    from egp_service._core import Reply

MICROSECONDS = 1_000_000


@dataclass(frozen=True, slots=True)
class Timings:
    """Where the time of a step went, in seconds."""

    total: float
    """From the call to the command."""
    queue: float = 0.0
    """Waiting in the service."""
    compute: float = 0.0
    """Decoding, control step and encoding in the service or engine."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What asking for one step brought."""

    reply: bytes | None
    """Bytes of the `StepReply` to this period's request."""
    late: tuple[bytes, ...] = ()
    """Replies to earlier requests that came since, oldest first."""
    queue: float = 0.0
    compute: float = 0.0
    replica: str = ""
    detail: str = ""
    """Why there is no reply."""
    refused: bool = False
    """Whether the service answered, but with an error."""


@dataclass(frozen=True, slots=True)
class Step:
    """One control period: the command, where it comes from, and all that was exchanged."""

    u: NDArray[np.float64]
    """Force [N] and steering rate [rad/s] for the actuators, inside all limits."""
    mode: Literal["normal", "tail", "stop"]
    """A plan made now, the rest of an older one, or braking to a stop."""
    limited: bool
    """Whether the gate had to change what the plan asked for."""
    status: str
    """The solver's status, or `no_reply`, `refused`, `not_finite` when there is none."""
    detail: str
    """Why there is no plan, in words; empty when there is one."""
    weights: NDArray[np.float64]
    """(N,) of the newest reply; empty before the first."""
    plan_x: NDArray[np.float64] | None
    """(T+1, 7), from the measured state on."""
    plan_u: NDArray[np.float64] | None
    """(T, 2)."""
    sigma: NDArray[np.float64] | None
    """(T+1, 3) standard deviations of `[v_x, v_y, omega]` along the plan, when asked for."""
    timings: Timings
    replica: str
    request: bytes
    """The bytes sent; empty when nothing was."""
    reply: bytes | None
    """The bytes of this period's reply."""
    late: tuple[bytes, ...]
    """Replies to earlier requests that came in the meantime."""


class Stepper(ABC):
    """Carry, deadline and gate around one way of computing a step.

    `dt` is the control period in seconds, `horizon` the number T of inputs in a plan, `members` the
    surfaces behind the weights.
    """

    def __init__(
        self,
        *,
        library: bytes,
        dt: float,
        horizon: int,
        history: int,
        members: list[str],
        gate: Mapping[str, float],
        want_sigma: bool,
    ) -> None:
        """Start with an empty carry; `gate` holds the gate's limits and settings."""
        self.library = library
        self.dt = dt
        self.horizon = horizon
        self.members = members
        self._want_sigma = want_sigma
        self._carry = Carry(library, history)
        self._gate = Gate(dt, dict(gate))
        self._weights: NDArray[np.float64] = np.empty(0)

    def step(
        self,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        *,
        deadline: float | None = None,
    ) -> Step:
        """Give the command for a measured state (7,), a reference (T+1, 4) and widths (T+1, 2).

        Call it once each period. It returns within `deadline` seconds (default: `dt`), with a
        command whatever happens to the service. Raises `EgpError` when the arguments have the wrong
        shape; a state that is not finite is no error but a stop.
        """
        start = time.perf_counter()
        state = np.ascontiguousarray(x, dtype=np.float64)
        if state.shape != (7,):
            raise EgpError(f"x must have shape (7,), got {state.shape}")
        request, answer, reply = b"", Answer(None), None
        if np.all(np.isfinite(state)):
            allowed = self.dt if deadline is None else deadline
            request = self._carry.request(
                state,
                np.ascontiguousarray(reference, dtype=np.float64),
                None if widths is None else np.ascontiguousarray(widths, dtype=np.float64),
                budget_us=int(allowed * MICROSECONDS),
                want_sigma=self._want_sigma,
            )
            answer = self._ask(request, self._carry.sequence, start + allowed)
            for late in answer.late:
                with suppress(EgpError):
                    self._take(late)
            try:
                reply = None if answer.reply is None else self._take(answer.reply)
            except EgpError as error:
                answer = replace(answer, refused=True, detail=f"unusable reply: {error}")
        else:
            self._carry.reset()  # the transition to the next state is unknown
        command = self._gate.command(self._carry.sequence, float(state[2]), float(state[6]))
        self._carry.applied(command.u)
        return Step(
            u=np.array(command.u),
            mode=command.mode,
            limited=command.limited,
            status=_status(request, answer, reply),
            detail=answer.detail,
            weights=self._weights,
            plan_x=_present(None if reply is None else reply.plan_x),
            plan_u=_present(None if reply is None else reply.plan_u),
            sigma=_present(None if reply is None else reply.sigma),
            timings=Timings(time.perf_counter() - start, answer.queue, answer.compute),
            replica=answer.replica,
            request=request,
            reply=answer.reply,
            late=answer.late,
        )

    def reset(self) -> None:
        """Leave STOP. The next step needs a fresh plan, otherwise it stops again."""
        self._gate.reset()

    def close(self) -> None:  # noqa: B027 - most have nothing to close
        """Let go of what the stepper holds."""

    def __enter__(self) -> Self:
        """Use as a context manager to close at the end."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close."""
        self.close()

    @abstractmethod
    def _ask(self, request: bytes, sequence: int, deadline: float) -> Answer:
        """Have `request` answered before `deadline` (of `time.perf_counter`), or say why not."""

    def _take(self, message: bytes) -> Reply:
        """Let carry and gate take over a reply; raises `EgpError` when it can't be used."""
        reply = decode_reply(message)
        newer = self._carry.accept(message)
        self._weights = self._carry.weights
        if newer and len(reply.plan_u) > 0 and self._gate.mode != "stop":
            self._gate.accept(reply.sequence, reply.plan_u)
        return reply


def _status(request: bytes, answer: Answer, reply: Reply | None) -> str:
    if reply is not None:
        return reply.status
    if not request:
        return "not_finite"
    return "refused" if answer.refused else "no_reply"


def _present(rows: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    """None for a field without rows: on the wire that is how a field is absent."""
    return None if rows is None or len(rows) == 0 else rows
