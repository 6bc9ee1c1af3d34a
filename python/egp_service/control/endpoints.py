"""Endpoints of zenoh: checked before they are used, and free ones."""

from __future__ import annotations

import re
import secrets
import socket
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from egp_service._core import EgpError, InvalidArgumentError

SERVICE_PORT: Final = 7447
MAP_PORT: Final = 7448
ROUTER_PORT: Final = 7449
MONITOR_PORT: Final = 7450
SERVICE_ENDPOINT: Final = f"tcp/127.0.0.1:{SERVICE_PORT}"
MAP_ENDPOINT: Final = f"tcp/127.0.0.1:{MAP_PORT}"
ROUTER_ENDPOINT: Final = f"tcp/127.0.0.1:{ROUTER_PORT}"
MONITOR_ENDPOINT: Final = f"tcp/127.0.0.1:{MONITOR_PORT}"
"""Where `egp serve`, `egp map`, `egp router` and `egp monitor` listen unless an option says
otherwise."""
ROS_ROUTER_ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""Where the router of rmw_zenoh listens."""
_FORM: Final = re.compile(r"(?P<protocol>[a-z][a-z-]*)/(?P<address>.+)")
_HOST_PROTOCOLS: Final = frozenset({"tcp", "tls", "udp", "quic", "ws"})
"""Protocols whose addresses have the form HOST:PORT; others have paths of files, for instance."""
_ADDRESS: Final = re.compile(r"(?:\[[^\]/?#]+\]|[^\[\]/?#]+):(?P<port>\d+)(?:[?#].*)?")
_PARTS: Final = re.compile(r"(\[[^\]]+\]|[^:\[\]]*)(?::(\d+))?")
_REACH_SECONDS: Final = 1.0
_LARGEST_PORT: Final = 65535
# Ray gives smaller ones to its workers.
_FREE_PORTS: Final = range(20_000, 32_000)
_given: Final[set[int]] = set()
_TCP: Final = re.compile(r"(?:tcp|tls)/\[?(?P<host>[^\]/]*)\]?:(?P<port>\d+)([?#].*)?")


def endpoint_list(endpoints: str | Sequence[str], port: int, *, configured: bool) -> list[str]:
    """Return the endpoints that an argument states; `port` is as for `check_endpoints`.

    `configured` states whether there is a configuration of zenoh, whose endpoints are used if the
    argument states none.

    Raises:
        TypeError: unless the argument is a text or a sequence of texts.
        InvalidArgumentError: as `check_endpoints`, and if there is neither an endpoint nor a
            configuration.

    """
    given: object = endpoints
    found = []
    several = isinstance(given, Sequence) and not isinstance(given, str | bytes)
    for one in endpoints if several else [given]:
        if not isinstance(one, str):
            raise TypeError(
                f"endpoints: expected a text such as 'tcp/127.0.0.1:{port}' or a list of texts, "
                f"got an object of the type {type(one).__name__}"
            )
        found.append(one)
    if not (found or configured):
        raise InvalidArgumentError(
            f"endpoints: expected at least one, such as 'tcp/127.0.0.1:{port}', or a zenoh_file"
        )
    check_endpoints(found, port)
    return found


def endpoint_names(endpoints: Sequence[str]) -> str:
    """Name the endpoints of `endpoint_list` in a message."""
    return ", ".join(endpoints) or "the endpoints of the zenoh file"


def check_endpoints(endpoints: Sequence[str], port: int = SERVICE_PORT) -> None:
    """Check the form `PROTOCOL/ADDRESS`, and `HOST:PORT` where this is the form of addresses.

    Raises:
        InvalidArgumentError: naming the first endpoint of another form, or with a larger port, and
            the endpoint that was probably meant, which has this `port` unless one is stated.

    """
    for endpoint in endpoints:
        form = _FORM.fullmatch(endpoint)
        if form is None:
            raise InvalidArgumentError(
                f"endpoint {endpoint!r}: expected PROTOCOL/ADDRESS; did you mean "
                f"{_completed(endpoint, port)!r}?"
            )
        if form["protocol"] not in _HOST_PROTOCOLS:
            continue
        address = _ADDRESS.fullmatch(form["address"])
        if address is None:
            raise InvalidArgumentError(
                f"endpoint {endpoint!r}: expected {form['protocol']}/HOST:PORT; did you mean "
                f"{_completed(endpoint, port)!r}?"
            )
        if int(address["port"]) > _LARGEST_PORT:
            raise InvalidArgumentError(
                f"endpoint {endpoint!r}: expected a port of at most {_LARGEST_PORT}"
            )


def _completed(endpoint: str, usual: int) -> str:
    """Give the endpoint that was probably meant: with a protocol, a host and a port."""
    before, _, address = endpoint.lower().rstrip("/").rpartition("/")
    if address in _HOST_PROTOCOLS:
        before, address = address, ""
    if address.isdecimal():
        address = f":{address}"
    elif address.count(":") > 1 and "[" not in address:  # an address of IPv6
        address = f"[{address}]"
    host, port = _PARTS.match(address).groups()  # type: ignore[union-attr]  # it matches any text
    if not port or int(port) > _LARGEST_PORT:
        port = usual
    protocol = before if before in _HOST_PROTOCOLS else "tcp"
    return f"{protocol}/{host or '127.0.0.1'}:{port}"


def check_free(endpoints: Sequence[str], port: int = SERVICE_PORT) -> None:
    """Check that a program can listen on the TCP ports among `endpoints`.

    An endpoint that is suggested in place of another form has this `port`.

    Raises:
        EgpError: if a port is in use or may not be used, or the host has no such address.

    """
    check_endpoints(endpoints, port)
    for endpoint in endpoints:
        reason = why_not_free(endpoint)
        if reason is not None:
            raise EgpError(
                f"cannot listen on {endpoint}: {reason}; stop the other program, or choose another "
                "endpoint with --listen, such as tcp/127.0.0.1:7460"
            )


def why_unreachable(endpoint: str) -> str | None:
    """Say why no program accepts connections at an endpoint; `None` if one does, or without TCP."""
    found = _TCP.fullmatch(endpoint)
    if found is None:
        return None
    try:
        socket.create_connection((found["host"], int(found["port"])), _REACH_SECONDS).close()
    except (OSError, OverflowError, UnicodeError) as error:
        return _reason(error)
    return None


def why_not_free(endpoint: str) -> str | None:
    """Say why a service cannot listen on an endpoint; `None` if it can, or if it is not TCP."""
    found = _TCP.fullmatch(endpoint)
    if found is None:
        return None
    host, port = found["host"], int(found["port"])
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen()
    except (OSError, OverflowError, UnicodeError) as error:
        return _reason(error)
    return None


def _reason(error: OSError | OverflowError | UnicodeError) -> str:
    if isinstance(error, UnicodeError):
        return "a part of the host's name is empty or longer than 63 letters"
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def free_port() -> int:
    """Return a port of the loopback address on which nobody listens, another one at each call.

    Linux by default gives ports above 32767 to outgoing connections and to programs that ask for
    any free port, so that only another process that calls this function may choose the same one
    before the service listens.
    """
    for _ in range(1000):
        port = secrets.choice(_FREE_PORTS)
        if port in _given:
            continue
        with suppress(OSError):
            socket.create_server(("127.0.0.1", port)).close()
            _given.add(port)
            return port
    raise EgpError("found no free port on 127.0.0.1")


def free_endpoint(protocol: str = "tcp") -> str:
    """Return an endpoint of the loopback address at which nobody listens; see `free_port`."""
    return f"{protocol}/127.0.0.1:{free_port()}"
