"""Sessions of zenoh: their configuration, and how they are opened and closed."""

from __future__ import annotations

import contextlib
import json
import os
import re
import time
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import zenoh

from egp_service import callbacks
from egp_service._core import EgpError, InvalidArgumentError, refused_setting
from egp_service.control.endpoints import check_endpoints
from egp_service.zenoh_threads import use_for

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

_PLACE: Final = re.compile(r" at /\S+\.rs:\d+\.?")
_PAUSE_SECONDS = 0.1
_LONGEST_TIMEOUT = 86_400.0  # s; zenoh's times overflow far above it
_TOKEN_SECONDS = 1.0
# How long a link may take to become a session, ms, at the key of zenoh's configuration.
_OPEN_TIMEOUT = "transport/unicast/open_timeout"
_LEAST_OPEN_MS = 500
LARGEST_AT_CLIENT: Final = 1 << 20
"""Largest message that a vehicle receives, bytes: above the size of any reply of the service.
Receiving a larger one could delay a step."""
LARGEST_AT_SERVICE: Final = 1 << 23
"""Largest message that a service or a router receives, bytes. It is larger than any message of a
vehicle, so that a vehicle gets an error for a request that is too large, and not silence."""
LEASE_MS: Final = 2000
"""Time without a message after which a link counts as lost, ms."""
RETRY: Final[Mapping[str, int]] = MappingProxyType(
    {"period_init_ms": 50, "period_max_ms": 200, "period_increase_factor": 2}
)
"""Times between two attempts to connect, as zenoh's configuration has them."""
_DEFAULTS: Mapping[str, object] = MappingProxyType(
    {
        "mode": "peer",
        "listen/endpoints": [],
        "connect/retry": dict(RETRY),
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/rx/max_message_size": LARGEST_AT_CLIENT,
    }
)


def direct(function: Any, end: Any = None) -> zenoh.handlers.Callback[Any]:  # noqa: ANN401
    """Let zenoh call a function in the thread in which it receives, and `end` after the last call.

    Rarely that is the main thread, which handles signals.
    """
    for called in (function, end):
        if called is not None:
            callbacks.mark(called)
    return zenoh.handlers.Callback(function, end, indirect=False)


def session_config(
    endpoints: Sequence[str],
    timeout: float,
    more: Mapping[str, object],
    file: str | os.PathLike[str] | None = None,
) -> zenoh.Config:
    """Configure a peer with its own link to every endpoint, or read a configuration from `file`.

    A session in zenoh's client mode has one link, and while the replica at its end is frozen, the
    others cannot be reached. Shared memory delays the first queries and can lose one silently.

    Raises:
        InvalidArgumentError: for a timeout that is negative or longer than a day, and for
            endpoints, a file or a setting that zenoh cannot use.

    """
    if not 0.0 <= timeout <= _LONGEST_TIMEOUT:
        raise InvalidArgumentError(
            f"expected 0 to {_LONGEST_TIMEOUT:g} seconds for timeout, got {timeout}"
        )
    settings: dict[str, object] = {
        "connect/timeout_ms": int(1000 * timeout),
        "connect/exit_on_failure": False,
    }
    check_endpoints(endpoints)
    if file is None:
        config = zenoh.Config()
        settings |= _DEFAULTS
    else:
        try:
            config = zenoh.Config.from_file(Path(file))
        except zenoh.ZError as error:
            raise InvalidArgumentError(
                f"zenoh file {file}: {refused_setting(str(error))}"
            ) from None
    if endpoints:
        settings["connect/endpoints"] = list(endpoints)
    settings |= more
    for path, value in settings.items():
        try:
            config.insert_json5(path, json.dumps(value))
        except zenoh.ZError as error:
            raise InvalidArgumentError(
                f"zenoh setting {path}: {refused_setting(str(error))}"
            ) from None
    return config


class _Zenoh:
    """Whether zenoh runs in this process, and whether it ran in the one from which it was forked.

    The threads of zenoh do not exist in a forked process, so that each of its functions would wait
    without an end there.
    """

    runs = False
    lost = False

    @classmethod
    def lose(cls) -> None:
        """Note a fork, in the forked process."""
        cls.lost = cls.runs


os.register_at_fork(after_in_child=_Zenoh.lose)


def check_process() -> None:
    """Raise `EgpError` in a process that was forked from one in which zenoh ran."""
    if _Zenoh.lost:
        raise EgpError(
            "this process was forked from one that had connected, and zenoh does not work in it: "
            'start processes with multiprocessing.get_context("spawn"), and connect in each of them'
        )


def is_lost() -> bool:
    """Whether this process was forked from one in which zenoh ran, so that zenoh cannot be used."""
    return _Zenoh.lost


def start_session(config: zenoh.Config) -> zenoh.Session:
    """Open a session with one attempt.

    Raises:
        zenoh.ZError: if no session opens.
        EgpError: as `check_process`.

    """
    check_process()
    _Zenoh.runs = True
    if config.get_json("mode") != '"router"':
        use_for(config.get_json("listen/endpoints"), config.get_json("connect/endpoints"))
    return zenoh.open(config)


def open_session(config: zenoh.Config, patience: float) -> zenoh.Session:
    """Open a session.

    In zenoh's client mode, in which there is no session without a link, each endpoint is tried, and
    all of them again until `patience` seconds have passed. With more time zenoh itself would try
    the first endpoint alone. A peer that accepts a connection and then says nothing costs at most
    that time, too.

    Raises:
        zenoh.ZError: if no session opens.
        EgpError: as `check_process`.

    """
    stated = json.loads(config.get_json(_OPEN_TIMEOUT))
    open_ms = min(stated, max(_LEAST_OPEN_MS, round(1e3 * patience)))
    config.insert_json5(_OPEN_TIMEOUT, str(open_ms))
    client = config.get_json("mode") == '"client"'
    if client:
        config.insert_json5("connect/timeout_ms", "0")
    late = time.monotonic() + patience
    while True:
        try:
            return start_session(config)
        except zenoh.ZError:
            if not client or time.monotonic() > late:
                raise
        time.sleep(_PAUSE_SECONDS)


def close_session(session: zenoh.Session) -> None:
    """Close a session, for which zenoh waits for up to 10 s if a link has been cut.

    In a process in which zenoh is lost, nothing is done: the session is that of another process.
    """
    if is_lost():
        return
    # zenoh's error says that a link was not closed in time. The link then ends with its lease, and
    # the error must not replace the result of what the session was used for.
    with contextlib.suppress(zenoh.ZError):
        session.close()  # type: ignore[no-untyped-call]


def zenoh_reason(error: Exception) -> str:
    """Return what zenoh says about an error, without the places in its source."""
    return _PLACE.sub("", str(error)).rstrip(".; ")


def look_again(
    session: zenoh.Session,
    key: str,
    on_token: Callable[[zenoh.Sample], None],
    on_silence: Callable[[], None],
) -> None:
    """After the loss of the liveliness token `key`, call `on_token` with it if it exists.

    If there is no answer in time, `on_silence` is called, which should lead to another call.

    zenoh reports in a thread for each link. When a replica changes to another router, its loss by
    the first one may be reported after its announcement by the second one, and nothing follows.
    """

    def deliver(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            on_token(reply.ok)
        else:
            on_silence()

    # A closed session has no tokens.
    with contextlib.suppress(zenoh.ZError):
        session.liveliness().get(key, direct(deliver), timeout=_TOKEN_SECONDS)
