# mypy: disable-error-code="type-arg, valid-type, misc, call-arg"
"""Messages of ROS 2 by a CDR library that the product does not use (pycdr2)."""

# The library reads the annotations, so that they must not be text.

from dataclasses import dataclass

from pycdr2 import IdlStruct
from pycdr2.types import array, float32, float64, int32, sequence, uint32


@dataclass
class Time(IdlStruct, typename="Time"):
    """builtin_interfaces/Time."""

    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="Header"):
    """std_msgs/Header."""

    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename="Vector3"):
    """geometry_msgs/Point and Vector3."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename="Quaternion"):
    """geometry_msgs/Quaternion."""

    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="Pose"):
    """geometry_msgs/Pose."""

    position: Vector3
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="PoseWithCovariance"):
    """geometry_msgs/PoseWithCovariance."""

    pose: Pose
    covariance: array[float64, 36]


@dataclass
class Twist(IdlStruct, typename="Twist"):
    """geometry_msgs/Twist."""

    linear: Vector3
    angular: Vector3


@dataclass
class TwistWithCovariance(IdlStruct, typename="TwistWithCovariance"):
    """geometry_msgs/TwistWithCovariance."""

    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename="Odometry"):
    """nav_msgs/Odometry."""

    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class PoseStamped(IdlStruct, typename="PoseStamped"):
    """geometry_msgs/PoseStamped."""

    header: Header
    pose: Pose


@dataclass
class Path(IdlStruct, typename="Path"):
    """nav_msgs/Path."""

    header: Header
    poses: sequence[PoseStamped]


@dataclass
class AckermannDrive(IdlStruct, typename="AckermannDrive"):
    """ackermann_msgs/AckermannDrive."""

    steering_angle: float32
    steering_angle_velocity: float32
    speed: float32
    acceleration: float32
    jerk: float32


@dataclass
class AckermannDriveStamped(IdlStruct, typename="AckermannDriveStamped"):
    """ackermann_msgs/AckermannDriveStamped."""

    header: Header
    drive: AckermannDrive


@dataclass
class Lateral(IdlStruct, typename="Lateral"):
    """autoware_control_msgs/Lateral."""

    stamp: Time
    control_time: Time
    steering_tire_angle: float32
    steering_tire_rotation_rate: float32
    is_defined_steering_tire_rotation_rate: bool


@dataclass
class Longitudinal(IdlStruct, typename="Longitudinal"):
    """autoware_control_msgs/Longitudinal."""

    stamp: Time
    control_time: Time
    velocity: float32
    acceleration: float32
    jerk: float32
    is_defined_acceleration: bool
    is_defined_jerk: bool


@dataclass
class Control(IdlStruct, typename="Control"):
    """autoware_control_msgs/Control."""

    stamp: Time
    control_time: Time
    lateral: Lateral
    longitudinal: Longitudinal
