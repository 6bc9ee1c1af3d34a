"""ROS 2 messages in CDR, and the hashes of their types.

`rosbags` encodes, decodes and hashes. The definitions that it lacks are those of ackermann_msgs 2,
autoware_control_msgs 1 and autoware_vehicle_msgs 1.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, Final

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from egp_service._core import EgpError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

ODOMETRY: Final = "nav_msgs/msg/Odometry"
PATH: Final = "nav_msgs/msg/Path"
STEERING: Final = "autoware_vehicle_msgs/msg/SteeringReport"
ACKERMANN: Final = "ackermann_msgs/msg/AckermannDriveStamped"
CONTROL: Final = "autoware_control_msgs/msg/Control"

_DEFINITIONS: Final = {
    "ackermann_msgs/msg/AckermannDrive": (
        "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\n"
        "float32 acceleration\nfloat32 jerk\n"
    ),
    ACKERMANN: "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n",
    STEERING: "builtin_interfaces/Time stamp\nfloat32 steering_tire_angle\n",
    "autoware_control_msgs/msg/Lateral": (
        "builtin_interfaces/Time stamp\nbuiltin_interfaces/Time control_time\n"
        "float32 steering_tire_angle\nfloat32 steering_tire_rotation_rate\n"
        "bool is_defined_steering_tire_rotation_rate\n"
    ),
    "autoware_control_msgs/msg/Longitudinal": (
        "builtin_interfaces/Time stamp\nbuiltin_interfaces/Time control_time\n"
        "float32 velocity\nfloat32 acceleration\nfloat32 jerk\n"
        "bool is_defined_acceleration\nbool is_defined_jerk\n"
    ),
    CONTROL: (
        "builtin_interfaces/Time stamp\nbuiltin_interfaces/Time control_time\n"
        "autoware_control_msgs/Lateral lateral\nautoware_control_msgs/Longitudinal longitudinal\n"
    ),
}


class MessageError(EgpError):
    """Bytes that are no message of the expected type."""


@cache
def _types() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def type_hash(name: str) -> str:
    """Return the hash `RIHS01_...` (REP-2016) of a type such as `nav_msgs/msg/Path`."""
    return str(_types().hash_rihs01(name))


def make(name: str, **fields: Any) -> Any:  # noqa: ANN401 - types made at run time
    """Make a message of a type from its fields."""
    return _types().types[name](**fields)


def stamp(nanoseconds: int) -> Any:  # noqa: ANN401
    """Return the time since the Unix epoch as `builtin_interfaces/msg/Time`."""
    sec, nanosec = divmod(nanoseconds, 1_000_000_000)
    return make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)


def encode(message: object, name: str) -> bytes:
    """Return a message as little-endian CDR behind its header of four bytes."""
    return bytes(_types().serialize_cdr(message, name))


def decode(data: bytes, name: str) -> Any:  # noqa: ANN401
    """Read a message from CDR with its header of four bytes; `MessageError` if it is none."""
    if len(data) < 4 or data[0] != 0 or data[1] not in {0, 1}:  # noqa: PLR2004
        raise MessageError(
            f"{name}: expected CDR with the header 00 00 or 00 01, got {data[:4].hex(' ')!r}; "
            "publish it with rmw_zenoh_cpp"
        )
    try:
        return _types().deserialize_cdr(data, name)
    except Exception as error:  # the decoder is made at run time and states no exceptions
        raise MessageError(f"{name}: {len(data)} bytes cannot be decoded: {error!r}") from error
