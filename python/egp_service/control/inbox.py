"""Events that other threads hand to the thread that drives."""

from __future__ import annotations

import threading
import time
from collections import deque
from contextlib import suppress
from typing import Generic, TypeVar

Event = TypeVar("Event")


class Inbox(Generic[Event]):
    """Events in the order in which they came.

    `put` may be called in every thread, and by a destructor or a handler of a signal within `get`.
    CPython's `queue.SimpleQueue` allows this, too, but its `get` waits without an end if a handler
    of a signal returns after the time that it was to wait.
    """

    def __init__(self) -> None:
        """Make an empty inbox."""
        self._events: deque[Event] = deque()
        self._arrived = threading.Lock()  # unlocked by an event
        self._arrived.acquire()

    def put(self, event: Event) -> None:
        """Add an event; returns at once."""
        self._events.append(event)
        with suppress(RuntimeError):  # it is unlocked already
            self._arrived.release()

    def get(self, patience: float) -> Event | None:
        """Return the oldest event, or `None` if none comes within `patience` seconds."""
        end = time.monotonic() + patience
        while not self._events:
            if not self._arrived.acquire(timeout=max(0.0, end - time.monotonic())):
                break
        return self._events.popleft() if self._events else None
