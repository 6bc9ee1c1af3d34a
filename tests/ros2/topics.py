"""Topics without a network, and time that passes only while a vehicle waits.

So a busy machine does not matter.
"""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from collections.abc import Callable


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
    """Whether messages have arrived, which none does while the vehicle waits for them."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock

    def wait(self, timeout: float | None = None) -> bool:
        """Let the time pass."""
        self._clock.sleep(timeout or 0.0)
        return self.is_set()


class Topics:
    """The topics of a vehicle: `messages` are read, and commands are kept."""

    def __init__(self, clock: Clock) -> None:
        self.messages: dict[str, Any] = {}
        self.commands: list[Any] = []
        self.arrived = Arrived(clock)
        self._clock = clock

    def subscribe(self, topic: str, kind: str) -> Any:  # noqa: ANN401
        """Return what reads a topic; a message that is an exception is raised."""
        del kind

        def take() -> tuple[Any, float] | None:
            message = self.messages.pop(topic, None)
            if isinstance(message, Exception):
                raise message
            return None if message is None else (message, self._clock.now)

        return SimpleNamespace(take=take)

    def publisher(self, topic: str, kind: str) -> Callable[[object], None]:
        """Return what keeps a command."""
        del topic, kind
        return self.commands.append
