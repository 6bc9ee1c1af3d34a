"""Keys, liveliness tokens and attachments of rmw_zenoh_cpp (its docs/design.md).

A message of a topic has the key `<domain>/<topic>/<type>/<hash>`. Each node, publisher and
subscription shows itself by the liveliness token
`@ros2_lv/<domain>/<session>/<node id>/<entity id>/<kind>/<enclave>/<namespace>/<node>`, which for
publishers and subscriptions ends with `/<topic>/<type>/<hash>/<qos>`, with `%` for `/` in names.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Final, Literal

import xxhash

from egp_service._core import InvalidArgumentError
from egp_service.ros2.messages import type_hash

_TOPIC: Final = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_NODE: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_GID_BYTES: Final = 16
_ATTACHMENT: Final = struct.Struct("<qqB16s")
# reliability:durability:history,depth:deadline:lifespan:liveliness, empty where it is the default
# (reliable, volatile, keep last).
_QOS: Final = "::,{depth}:,:,:,,"

Kind = Literal["MP", "MS"]


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of one type in a domain."""

    domain: int
    """`ROS_DOMAIN_ID`, 0 to 232."""
    name: str
    """Fully qualified name, such as `/localization/kinematic_state`; see `check_topic`."""
    type: str
    """Type, such as `nav_msgs/msg/Odometry`."""

    @property
    def dds_type(self) -> str:
        """The type's name in DDS, such as `nav_msgs::msg::dds_::Odometry_`."""
        package, _, name = self.type.split("/")
        return f"{package}::msg::dds_::{name}_"

    @property
    def key(self) -> str:
        """The key on which messages are published."""
        return f"{self.domain}{self.name}/{self.dds_type}/{type_hash(self.type)}"


def check_topic(name: str) -> None:
    """Raise `InvalidArgumentError` unless a topic may have the fully qualified name in ROS 2."""
    if not _TOPIC.fullmatch(name):
        raise InvalidArgumentError(
            f"topic {name!r}: expected a fully qualified name such as /vehicle/odometry"
        )


def check_node(name: str) -> None:
    """Raise `InvalidArgumentError` unless a node may have the name in ROS 2."""
    if not _NODE.fullmatch(name):
        raise InvalidArgumentError(
            f"node {name!r}: expected letters, digits and underscores, such as egp_controller"
        )


def node_token(domain: int, session: str, node: str) -> str:
    """Return the token of a node without namespace and enclave; `session` is zenoh's identity."""
    return f"@ros2_lv/{domain}/{session}/0/0/NN/%/%/{node}"


def endpoint_token(
    topic: Topic, session: str, node: str, *, entity: int, kind: Kind, depth: int
) -> str:
    """Return the token of a publisher (`MP`) or a subscription (`MS`) of the node.

    `entity` is its number within the session, and `depth` that of its history.
    """
    return (
        f"@ros2_lv/{topic.domain}/{session}/0/{entity}/{kind}/%/%/{node}/"
        f"{topic.name.replace('/', '%')}/{topic.dds_type}/{type_hash(topic.type)}/"
        f"{_QOS.format(depth=depth)}"
    )


def gid(token: str) -> bytes:
    """Return the identity (16 bytes) of the publisher with this token, XXH3 of 128 bits."""
    value: int = xxhash.xxh3_128_intdigest(token.encode())
    return value.to_bytes(_GID_BYTES, "little")


def encode_attachment(sequence: int, time_ns: int, publisher: bytes) -> bytes:
    """Return the attachment of a message: number from 1 on, time [ns since 1970], identity."""
    return _ATTACHMENT.pack(sequence, time_ns, _GID_BYTES, publisher)
