"""Topics without a network, and time that passes only while a vehicle waits.

So a busy machine does not matter.
"""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Self, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable

    # Times of arrival, topics and messages.
    Timetable: TypeAlias = list[tuple[float, str, Any]]


class Clock:
    """The adapter's `time`."""

    time_ns = staticmethod(time.time_ns)

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        """Give the present time."""
        return self.now

    def sleep(self, seconds: float) -> None:
        """Let time pass at once."""
        self.now += seconds


class Reader:
    """The adapter's thread for paths, which is done at once."""

    def __init__(self, max_workers: int) -> None:
        assert max_workers == 1

    def submit(self, read: Callable[[], object]) -> Future[object]:
        """Call it, and give its result."""
        future = Future[object]()
        try:
            future.set_result(read())
        except Exception as error:  # noqa: BLE001 - as in a thread
            future.set_exception(error)
        return future

    def __enter__(self) -> Self:
        """Do nothing."""
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing."""


class Arrived(threading.Event):
    """Whether messages have arrived; while the vehicle waits only those of a timetable do."""

    def __init__(self, clock: Clock, timetable: Timetable) -> None:
        super().__init__()
        self._clock, self._timetable = clock, timetable

    def wait(self, timeout: float | None = None) -> bool:
        """Let the time pass, at most until the next message of the timetable."""
        end = self._clock.now + (timeout or 0.0)
        if not self.is_set() and self._timetable and self._timetable[0][0] <= end:
            self._clock.now = max(self._clock.now, self._timetable[0][0])
            self.set()
        elif not self.is_set():
            self._clock.now = end
        return self.is_set()


class Topics:
    """The topics of a vehicle: `messages` are read, and commands are kept.

    `timetable` has further messages in the order of their times of arrival.
    """

    def __init__(self, clock: Clock, timetable: Timetable | None = None) -> None:
        self.messages: dict[str, Any] = {}
        self.commands: list[Any] = []
        self._timetable: Timetable = [] if timetable is None else timetable
        self.arrived = Arrived(clock, self._timetable)
        self._clock = clock
        self._due: dict[str, tuple[Any, float]] = {}

    def subscribe(self, topic: str, kind: str) -> Any:  # noqa: ANN401
        """Return what reads a topic; a message that is an exception is raised."""
        del kind

        def take() -> tuple[Any, float] | None:
            while self._timetable and self._timetable[0][0] <= self._clock.now:
                arrival, name, due = self._timetable.pop(0)
                self._due[name] = (due, arrival)
            if topic in self._due:
                return self._due.pop(topic)
            message = self.messages.pop(topic, None)
            if isinstance(message, Exception):
                raise message
            return None if message is None else (message, self._clock.now)

        return SimpleNamespace(take=take)

    def publisher(self, topic: str, kind: str) -> Callable[[object], None]:
        """Return what keeps a command."""
        del topic, kind
        return self.commands.append
