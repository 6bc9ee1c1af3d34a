"""Connections to the live page: their number, and the time that each may take for its request.

uvicorn bounds neither. A client that begins a request and never ends it would keep a descriptor,
and without free descriptors the server accepts no connection.
"""

from __future__ import annotations

import errno
import resource
from typing import TYPE_CHECKING, Any, ClassVar, Final

from uvicorn.protocols.http.h11_impl import H11Protocol

if TYPE_CHECKING:
    import asyncio

    from uvicorn.config import Config
    from uvicorn.server import ServerState

REQUEST_SECONDS: Final = 5.0
"""Time in which a connection has to send its request."""
BACKLOG: Final = 32
"""Connections that the system accepts before the server looks at their number."""
_MOST: Final = 512
_SCARCE: Final = (errno.EMFILE, errno.ENFILE)


class BoundedConnection(H11Protocol):
    """A connection that is closed if no request comes on it in time.

    A connection beyond `most` closes the oldest one that waits for a request. If all are being
    answered, it is closed itself.
    """

    most: ClassVar[int] = _MOST

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        """Wait for the connection."""
        super().__init__(config, server_state, app_state, _loop)
        self._begun = self.loop.time()
        self._answered: object = None
        self._look_again: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Make room for the connection, and expect its request."""
        super().connection_made(transport)
        self._look_again = self.loop.call_later(REQUEST_SECONDS, self._look)
        if len(self.connections) > self.most:
            bounded = [one for one in self.connections if isinstance(one, BoundedConnection)]
            waiting = [one for one in bounded if one.waits()]
            min(waiting, key=lambda one: one._begun, default=self).transport.abort()  # noqa: SLF001

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        if self._look_again is not None:
            self._look_again.cancel()
        super().connection_lost(exc)

    def waits(self) -> bool:
        """Return whether no request is being answered."""
        # uvicorn's attribute is None before the first request.
        cycle: Any = self.cycle
        return cycle is None or bool(cycle.response_complete)

    def _look(self) -> None:
        """Close the connection if no request was answered since the last look."""
        if self.waits():
            if self.cycle is self._answered:
                self.transport.abort()
                return
            self._answered = self.cycle
        self._look_again = self.loop.call_later(REQUEST_SECONDS, self._look)


def allow_descriptors() -> None:
    """Raise the limit of open descriptors to the hard one; connections take at most half of it."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    if most != resource.RLIM_INFINITY:
        BoundedConnection.most = max(1, min(_MOST, most // 2))


def report(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report what fails in the event loop, except a lack of file descriptors.

    The loop accepts connections again a second later, and a traceback for each attempt would fill
    the log.
    """
    failed = context.get("exception")
    if not (isinstance(failed, OSError) and failed.errno in _SCARCE):
        loop.default_exception_handler(context)
