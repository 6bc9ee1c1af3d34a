"""The web server of the live page: static files, and a stream of events for each open page.

The page makes no request beyond this server; its content security policy lets the browser enforce
that.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import json
import signal
import socket
import time
from importlib import resources
from typing import TYPE_CHECKING, Final

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from egp_service._core import EgpError
from egp_service.monitor.connections import (
    BACKLOG,
    BoundedConnection,
    allow_descriptors,
    report,
)
from egp_service.monitor.fleet import Fleet

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from starlette.requests import Request
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from egp_service.monitor.listener import Listener

PAGE = resources.files("egp_service.monitor") / "page"
REFRESH_SECONDS: Final = 0.1
RETRY_MS: Final = 300
"""Time after which a page connects again to a monitor that ended."""
# As a request names them, with brackets about an address that has colons.
_NAMED: Final = ["127.0.0.1", "localhost", "::1", "[::1]"]
_HEADERS: Final = [
    (b"content-security-policy", b"default-src 'self'; frame-ancestors 'none'; base-uri 'none'"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cache-control", b"no-cache"),
]


class _Refresh:
    """Updates the fleet ten times a second and tells the open pages."""

    def __init__(self, listener: Listener, ended: Callable[[], bool]) -> None:
        self.fleet = Fleet()
        self.snapshot = ""
        self.ended = ended
        self._listener = listener
        self._pages = 0
        self._tick = asyncio.Event()

    async def run(self) -> None:
        """Update until the server ends."""
        try:
            while not self.ended():
                now = time.monotonic()
                self._listener.deliver(self.fleet)
                self.fleet.update(now)
                if self._pages:
                    self.snapshot = self.fleet.snapshot(now)
                self._tick.set()
                self._tick = asyncio.Event()
                await asyncio.sleep(max(0.0, now + REFRESH_SECONDS - time.monotonic()))
        finally:
            self._tick.set()

    async def stream(self, selected: str) -> AsyncIterator[str]:
        """Give the events of one page that shows the vehicle `selected`."""
        run, sampled, happened, road_sent = "", 0, 0, False
        self._pages += 1
        try:
            yield f"retry: {RETRY_MS}\n\n"
            while True:
                await self._tick.wait()
                if self.ended():
                    return
                fleet = self.fleet
                parts = [f'"fleet":{self.snapshot}'] if self.snapshot else []
                events = [event for event in fleet.events if int(str(event["number"])) >= happened]
                happened = fleet.happened
                if events:
                    parts.append(f'"events":{json.dumps(events)}')
                vehicle = fleet.vehicles.get(selected)
                if vehicle is not None:
                    detail, count = vehicle.detail(sampled)
                    if detail["run"] != run:
                        run, road_sent = str(detail["run"]), False
                        detail, count = vehicle.detail(0)
                        detail["begin"] = True
                    sampled = count
                    if vehicle.road is not None and not road_sent:
                        road = {n: [round(v, 2) for v in c] for n, c in vehicle.road.items()}
                        detail["road"], road_sent = road, True
                    parts.append(f'"detail":{json.dumps(detail)}')
                yield f"data: {{{','.join(parts)}}}\n\n"
        finally:
            self._pages -= 1


class _Headers:
    """Adds the security headers to every response."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *_HEADERS]
            await send(message)

        await self._app(scope, receive, with_headers)


def bind(host: str, port: int) -> socket.socket:
    """Listen on `host` and `port`, 0 being any free port; an empty host is an error."""
    if not host:
        raise EgpError(
            "the host of the page is empty: give --host an address of this machine, such as "
            "127.0.0.1, or 0.0.0.0 for all of them"
        )
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        raise EgpError(
            f"cannot serve the page on {host} port {port}: {error}; choose another one with "
            "--host and --port"
        ) from error


def allowed_hosts(host: str, address: str) -> list[str]:
    """Return the hosts that a request may name for a page that is bound to an address.

    `host` is the name or address that was asked for. On a loopback address they are its names,
    otherwise all.
    """
    if not ipaddress.ip_address(address).is_loopback:
        return ["*"]
    return [*_NAMED, host, f"[{host}]", address, f"[{address}]"]


def serve(listener: Listener, bound: socket.socket, host: str, started: Callable[[], None]) -> None:
    """Serve the page until SIGTERM, SIGINT or SIGHUP; call `started` once these end it in order.

    On a loopback address only requests that name it as their host are answered, so that a foreign
    page cannot read the data by a name that resolves to this machine.

    Raises:
        Exception: what the listener and the fleet raise, which ends the server.

    """
    refresh: _Refresh
    failures: list[Exception] = []

    async def update() -> None:
        try:
            await refresh.run()
        except Exception as error:  # noqa: BLE001 - the page would show what is old
            failures.append(error)
            server.should_exit = True

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        nonlocal refresh
        asyncio.get_running_loop().set_exception_handler(report)
        refresh = _Refresh(listener, lambda: server.should_exit)
        task = asyncio.create_task(update())
        started()
        yield
        task.cancel()

    async def events(request: Request) -> StreamingResponse:
        chosen = request.query_params.get("vehicle", "")
        return StreamingResponse(refresh.stream(chosen), media_type="text/event-stream")

    hosts = allowed_hosts(host, bound.getsockname()[0])
    app = Starlette(
        routes=[Route("/events", events), Mount("/", StaticFiles(directory=str(PAGE), html=True))],
        middleware=[Middleware(_Headers), Middleware(TrustedHostMiddleware, allowed_hosts=hosts)],
        lifespan=lifespan,
    )
    allow_descriptors()
    config = uvicorn.Config(
        app,
        http=BoundedConnection,
        ws="none",
        log_level="error",
        backlog=BACKLOG,
        timeout_graceful_shutdown=1,
    )
    server = uvicorn.Server(config)
    # An exception within the event loop would end in a traceback of every open page.
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # as under `nohup`
        signal.signal(signal.SIGHUP, server.handle_exit)
    server.run(sockets=[bound])
    if failures:
        raise failures[0]
