"""A router of zenoh between vehicles and services."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import zenoh

from egp_service._core import EgpError, InvalidArgumentError
from egp_service.control.session import (
    LARGEST_AT_SERVICE,
    close_session,
    session_config,
    start_session,
    zenoh_reason,
)
from egp_service.control.step import Closing

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence


class Router(Closing):
    """Pass questions, answers and announcements on between all who connect.

    It is a session of zenoh in router mode, which routes as `zenohd` does. It ends with `close` or
    with the block of `with`; services and vehicles connect again once another one listens.
    """

    def __init__(
        self,
        listen: Sequence[str],
        connect: Sequence[str] = (),
        zenoh_file: str | os.PathLike[str] | None = None,
    ) -> None:
        """Listen on endpoints such as `tcp/0.0.0.0:7449`, and connect to other routers.

        Without endpoints those of `zenoh_file` are used, a configuration of zenoh in JSON5 with TLS
        and access control.

        Raises:
            EgpError: if zenoh opens no session.
            InvalidArgumentError: for endpoints or a configuration that cannot be used, or that is
                meant for another program.

        """
        more: dict[str, object] = {"mode": "router"}
        if listen:
            more["listen/endpoints"] = list(listen)
        if zenoh_file is None:
            more["transport/link/rx/max_message_size"] = LARGEST_AT_SERVICE
        config = session_config(connect, 0.0, more, zenoh_file)
        if zenoh_file is not None:
            _check_mode(Path(zenoh_file))
        try:
            self._session = start_session(config)
        except zenoh.ZError as error:
            raise EgpError(
                f"zenoh cannot open a router's session: {zenoh_reason(error)}"
            ) from error
        stated = json.loads(config.get_json("listen/endpoints"))
        if isinstance(stated, dict):  # the endpoints of each mode
            stated = stated.get("router", [])
        self.endpoints: tuple[str, ...] = tuple(stated)
        """Where it listens."""

    def close(self) -> None:
        """Close all links."""
        close_session(self._session)


def _check_mode(file: Path) -> None:
    """Raise `InvalidArgumentError` if a configuration states that it is no router's."""
    mode = json.loads(zenoh.Config.from_file(file).get_json("mode"))
    if mode not in (None, "router"):
        raise InvalidArgumentError(
            f"{file} has the mode {mode!r}, so it is the file of a service, a map or a client, and "
            "its access control is not a router's: state router.json5 of `egp keys`, or a file "
            'with the mode "router"'
        )
