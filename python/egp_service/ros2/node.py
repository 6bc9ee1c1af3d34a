"""A node in the graph of ROS 2, as a session of zenoh."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any, Final

import zenoh

from egp_service._core import EgpError
from egp_service.control.session import (
    LARGEST_AT_SERVICE,
    close_session,
    open_session,
    session_config,
    zenoh_reason,
)
from egp_service.control.step import Closing
from egp_service.ros2.messages import decode, encode
from egp_service.ros2.rmw_zenoh import (
    Topic,
    check_node,
    encode_attachment,
    endpoint_token,
    gid,
    node_token,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from egp_service.ros2.rmw_zenoh import Kind

_DEPTH: Final = 1  # messages that a topic keeps: the newest one
_CONNECT_SECONDS: Final = 5.0


class Newest:
    """The newest message of a subscription, which zenoh's thread replaces."""

    def __init__(self, topic: Topic, arrived: threading.Event) -> None:
        """Set `arrived` with each message."""
        self.topic = topic
        self._arrived = arrived
        self._newest: tuple[bytes, float] | None = None

    def take(self) -> tuple[Any, float] | None:
        """Return the message and its time of arrival (monotonic, s), once; errors as `decode`."""
        newest, self._newest = self._newest, None
        if newest is None:
            return None
        data, arrival = newest
        return decode(data, self.topic.type), arrival

    def put(self, sample: zenoh.Sample) -> None:
        """Keep a sample; zenoh calls this."""
        self._newest = (sample.payload.to_bytes(), time.monotonic())
        self._arrived.set()


class Node(Closing):
    """A node of rmw_zenoh with publishers and subscriptions; it leaves the graph on `close`."""

    def __init__(
        self, name: str, domain: int, endpoint: str | None, file: Path | None = None
    ) -> None:
        """Connect to the router `ros2 run rmw_zenoh_cpp rmw_zenohd` at `endpoint`.

        `file` is a configuration of zenoh (JSON5) in place of the defaults. Without `endpoint` the
        router is at the endpoints of `file`.

        Raises:
            EgpError: if no session opens.
            InvalidArgumentError: for a wrong name.

        """
        check_node(name)
        more: dict[str, object] = {"connect/exit_on_failure": True}
        if file is None:
            # Nodes of ROS 2 listen on their own machine only, and their router passes on nothing
            # between two peers. A client reaches nodes of other machines through the router.
            more["mode"] = "client"
            # A path of 40 000 poses is smaller.
            more["transport/link/rx/max_message_size"] = LARGEST_AT_SERVICE
        endpoints = [] if endpoint is None else [endpoint]
        config = session_config(endpoints, _CONNECT_SECONDS, more, file)
        try:
            self._session = open_session(config, _CONNECT_SECONDS)
        except zenoh.ZError as error:
            where = endpoint or f"the endpoints of {file}"
            raise EgpError(
                f"no router of rmw_zenoh at {where}: {zenoh_reason(error)}; start one with "
                "`ros2 run rmw_zenoh_cpp rmw_zenohd` or `egp router`, or name another --router"
            ) from error
        self._name, self._domain = name, domain
        self._id = str(self._session.zid())
        self.arrived = threading.Event()
        """Is set when a message arrives."""
        self._entities = 0
        # References that keep zenoh's declarations alive.
        self._held: list[object] = []
        self._declare_token(node_token(domain, self._id, name))

    def subscribe(self, topic: str, kind: str) -> Newest:
        """Subscribe to a topic of a type such as `nav_msgs/msg/Path`."""
        described = Topic(self._domain, topic, kind)
        newest = Newest(described, self.arrived)
        self._held.append(self._session.declare_subscriber(described.key, newest.put))
        self._announce(described, "MS")
        return newest

    def publisher(self, topic: str, kind: str) -> Callable[[object], None]:
        """Return a function that publishes messages of a type on a topic."""
        described = Topic(self._domain, topic, kind)
        identity = gid(self._announce(described, "MP"))
        publisher = self._session.declare_publisher(
            described.key, congestion_control=zenoh.CongestionControl.DROP
        )
        sequence = 0

        def publish(message: object) -> None:
            nonlocal sequence
            sequence += 1
            publisher.put(
                encode(message, kind),
                attachment=encode_attachment(sequence, time.time_ns(), identity),
            )

        return publish

    def _announce(self, topic: Topic, kind: Kind) -> str:
        """Declare the token of a publisher or a subscription, and return it."""
        self._entities += 1
        token = endpoint_token(
            topic, self._id, self._name, entity=self._entities, kind=kind, depth=_DEPTH
        )
        self._declare_token(token)
        return token

    def _declare_token(self, token: str) -> None:
        self._held.append(self._session.liveliness().declare_token(token))

    def close(self) -> None:
        """Leave the graph and close the session."""
        close_session(self._session)
