"""Replays of recorded control steps: the same, or with another library or other settings.

The service keeps no state, so that each recorded request can be answered again by itself. Every
step therefore begins from the recorded history, weights and plan, also with other settings: the
differences are those of single steps and do not add up.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import Engine, RefusedError, decode_ready, decode_reply
from egp_service.control.messages import message_class
from egp_service.control.recorded import RecordingError
from egp_service.control.toml_text import dumps

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from egp_service.control.recorded import Recorded

MATTERS: Final = 0.01
"""Share of an actuator's range from which a difference of commands matters."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What a reply says about the command."""

    status: str
    """The solver's status; `no reply`; or the error by which the request was answered."""
    u: NDArray[np.float64]
    """First input (2,) of the plan, N and rad/s; NaN without a plan."""
    weights: NDArray[np.float64]
    """Weights (N,); empty without a reply."""


@dataclass(frozen=True)
class Replay:
    """The steps of a recording that had a reply, with the replies of the replay."""

    time: NDArray[np.float64]
    """Times (n,) of the steps since the start of the recording, s."""
    x: NDArray[np.float64]
    """Measured states (n, 7)."""
    recorded: list[Answer]
    now: list[Answer]
    same: NDArray[np.bool_]
    """Whether the replies have the same bytes (n,)."""
    ranges: NDArray[np.float64]
    """Ranges (2,) of the actuators, N and rad/s."""
    unanswered: int
    """Number of recorded requests without a reply, which are not replayed."""

    @cached_property
    def u_recorded(self) -> NDArray[np.float64]:
        """Recorded first inputs (n, 2)."""
        return np.array([answer.u for answer in self.recorded]).reshape(-1, 2)

    @cached_property
    def u_now(self) -> NDArray[np.float64]:
        """First inputs (n, 2) of the replay."""
        return np.array([answer.u for answer in self.now]).reshape(-1, 2)

    @cached_property
    def share(self) -> NDArray[np.float64]:
        """Difference (n,) of the first inputs: the larger share of an actuator's range.

        It is infinite where only one of the two has a plan, and 0 where none has.
        """
        share: NDArray[np.float64] = np.max(
            np.abs(self.u_now - self.u_recorded) / self.ranges, axis=1
        )
        planned, recorded = (np.isfinite(u).all(axis=1) for u in (self.u_now, self.u_recorded))
        share[planned != recorded] = np.inf
        share[~planned & ~recorded] = 0.0
        return share

    @property
    def first_different(self) -> int | None:
        """Index of the first step whose reply has other bytes."""
        return _first(~self.same)

    @property
    def first_that_matters(self) -> int | None:
        """Index of the first step whose command differs by more than `MATTERS`."""
        return _first(self.share > MATTERS)


def replay(
    recorded: Recorded,
    library: Path,
    settings: Mapping[str, object],
    report: Callable[[int, int], None] = lambda _done, _total: None,
) -> Replay:
    """Answer the recorded requests again with a library file and settings.

    Requests are sent unchanged to the library that they name. For another library they name that
    one, and leave out what only the members of the recorded one give: their predictions and, if the
    members' names differ, the weights. For a shorter window they leave out the oldest transitions.
    `report(done, total)` is called after each step.

    Raises:
        RecordingError: if the period or the horizon differ from the recorded ones, the window is
            longer than the recorded one, or no recorded request had a reply.
        EgpError: for a library or settings that cannot be used.

    """
    engine = Engine(str(library), dumps(settings))
    window = decode_ready(engine.ready).history
    _check(recorded, engine, window)
    change = _retarget(recorded, engine, window)
    steps = [(step, step.reply) for step in recorded.steps if step.reply is not None]
    if not steps:
        raise RecordingError("no request in the recording has a reply, so nothing can be compared")
    before, now, same = [], [], []
    for step, reply in steps:
        try:
            data = engine.step(change(step.request))
            answer = _answer(data)
        except RefusedError as error:
            data, answer = b"", Answer(str(error), np.full(2, np.nan), np.zeros(0))
        before.append(_answer(reply))
        now.append(answer)
        same.append(data == reply)
        report(len(same), len(steps))
    limits = engine.vehicle.gate_limits()
    return Replay(
        time=np.array([step.time for step, _ in steps]),
        x=np.array([step.x for step, _ in steps]),
        recorded=before,
        now=now,
        same=np.array(same),
        ranges=np.array([limits["force_max"] - limits["force_min"], 2.0 * limits["steering_rate"]]),
        unanswered=len(recorded.steps) - len(steps),
    )


def _check(recorded: Recorded, engine: Engine, window: int) -> None:
    dt, horizon = recorded.dt, recorded.horizon
    if engine.dt != dt:
        raise RecordingError(
            f"the recording has a period of {dt:g} s, the library {engine.dt:g} s: "
            "give a library of the same period"
        )
    if engine.horizon != horizon:
        raise RecordingError(
            f"the recorded references have a horizon of {horizon} periods, the settings "
            f"{engine.horizon}: state horizon = {horizon}, or drive again"
        )
    longest = _window(recorded)
    if longest is not None and window > longest:
        raise RecordingError(
            f"the recorded requests hold {longest} transitions at most, and the settings' window "
            f"has {window}: state weights.window = {longest} or less, or drive again"
        )


def _window(recorded: Recorded) -> int | None:
    """Return the window of the drive; None if the recording does not hold it."""
    weights = (recorded.settings or {}).get("weights")
    return int(weights["window"]) if isinstance(weights, dict) and "window" in weights else None


def _retarget(recorded: Recorded, engine: Engine, window: int) -> Callable[[bytes], bytes]:
    """Give what makes a recorded request one to the engine's library and window."""
    other_library = engine.library_id.hex() != recorded.about["library"]
    other_members = engine.members != recorded.members

    def change(data: bytes) -> bytes:
        request = message_class("StepRequest").FromString(data)
        rows = request.history_z.shape[0] if request.HasField("history_z") else 0
        if not other_library and rows <= window:
            return data
        request.library = engine.library_id
        request.ClearField("history_f")
        if other_members:
            request.ClearField("weights")
        for history in (request.history_z, request.history_y) if rows > window else ():
            # Rows are the newest first.
            history.data = history.data[: len(history.data) // rows * window]
            history.shape[0] = window
        changed: bytes = request.SerializeToString()
        return changed

    return change


def _answer(data: bytes) -> Answer:
    reply = decode_reply(data)
    u = np.asarray(reply.plan_u)
    first = u[0] if len(u) else np.full(2, np.nan)
    return Answer(reply.status, first, np.asarray(reply.weights))


def _first(marks: NDArray[np.bool_]) -> int | None:
    places = np.flatnonzero(marks)
    return int(places[0]) if len(places) else None
