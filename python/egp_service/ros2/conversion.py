"""What messages of ROS 2 state, in the quantities of the control step, and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from egp_service._core import EgpError, Path
from egp_service.quantities import DELTA, OMEGA, P_X, P_Y, PSI, V_X, V_Y
from egp_service.ros2.messages import ACKERMANN, CONTROL, make, stamp

if TYPE_CHECKING:
    from numpy.typing import NDArray

LARGEST: Final = 1e7
"""m, m/s and so on; requests allow no larger number, and coordinates of UTM are smaller."""
_FEWEST_POSES = 4
# A path is closed if its ends are not further apart than this multiple of its median spacing.
_CLOSING_GAP = 1.5


class PathError(EgpError):
    """A path that cannot be followed."""


@dataclass(frozen=True, slots=True)
class Command:
    """What a vehicle of ROS 2 is asked to do."""

    steering_angle: float
    """Angle of the front wheels at the end of the period, rad, positive to the left."""
    steering_rate: float
    """Steering rate in the period, rad/s, positive to the left."""
    speed: float
    """Speed at the end of the period, m/s; 0 in a stop."""
    acceleration: float
    """Force over mass, m/s², negative for braking."""


def state_of(odometry: Any, delta: float, to_centre: float) -> NDArray[np.float64]:  # noqa: ANN401
    """Return the state (7,) of the centre of mass that an odometry message states.

    The pose is that of the child frame in the message's frame, and the twist that of the child
    frame in its own axes. The centre of mass lies `to_centre` metres ahead of the child frame's
    origin: p = p_0 + c (cos psi, sin psi), v_y = v_y0 + c omega. `delta` is the steering angle.
    """
    position, q = odometry.pose.pose.position, odometry.pose.pose.orientation
    linear, omega = odometry.twist.twist.linear, odometry.twist.twist.angular.z
    psi = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    x = np.zeros(7)
    x[P_X] = position.x + to_centre * np.cos(psi)
    x[P_Y] = position.y + to_centre * np.sin(psi)
    x[V_X], x[PSI] = linear.x, psi
    x[V_Y], x[OMEGA], x[DELTA] = linear.y + to_centre * omega, omega, delta
    return x


def extrapolated(x: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """Return the state after `dt` seconds with the same speeds and yaw rate, on an arc."""
    ahead = x.copy()
    half = 0.5 * dt * x[OMEGA]
    cos, sin = np.cos(x[PSI] + half), np.sin(x[PSI] + half)
    chord = dt * np.sinc(half / np.pi)
    ahead[P_X] += chord * (x[V_X] * cos - x[V_Y] * sin)
    ahead[P_Y] += chord * (x[V_X] * sin + x[V_Y] * cos)
    ahead[PSI] += dt * x[OMEGA]
    return ahead


def positions_of(message: Any) -> NDArray[np.float64]:  # noqa: ANN401
    """Return the positions (n, 2) of the poses of a `nav_msgs/msg/Path`, m."""
    positions = [(pose.pose.position.x, pose.pose.position.y) for pose in message.poses]
    return np.array(positions, dtype=np.float64).reshape(-1, 2)


def path_of(points: NDArray[np.float64], friction: float) -> Path:
    """Return the path through positions (n, 2), closed if its ends are close to each other.

    Poses at the same place count once. `friction` is that of the whole road.

    Raises:
        PathError: for poses that are not finite or too far away, fewer than four different ones, or
            ones that no path passes.

    """
    if not np.isfinite(points).all():
        wrong = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise PathError(f"pose {wrong} of the path is at {points[wrong].tolist()}: not finite")
    if (far := np.abs(points).max(initial=0.0)) > LARGEST:
        raise PathError(
            f"the path has a coordinate of {far:g} m: expected at most {LARGEST:g} m; publish it "
            "in a frame with a nearer origin"
        )
    steps = np.hypot(*np.diff(points, axis=0).T) if len(points) > 1 else np.zeros(0)
    points = points[np.concatenate(([True], steps > 1e-6))[: len(points)]]  # noqa: PLR2004
    if len(points) < _FEWEST_POSES:
        raise PathError(
            f"path with {len(points)} different poses: expected at least {_FEWEST_POSES}; publish "
            "the road ahead as poses about 1 m apart"
        )
    spacing = float(np.median(np.hypot(*np.diff(points, axis=0).T)))
    gap = float(np.hypot(*(points[0] - points[-1])))
    closed = gap <= _CLOSING_GAP * spacing
    if closed and gap < 0.5 * spacing:
        points = points[:-1]
    try:
        path = Path.from_points(np.ascontiguousarray(points), closed)
        return path.with_friction([(0.0, friction)])
    except EgpError as error:
        raise PathError(f"path of {len(points)} poses: {error}") from error


def message_of(command: Command, kind: str, time_ns: int, frame: str) -> object:
    """Return a command as a message of the type `ACKERMANN` or `CONTROL`."""
    now = stamp(time_ns)
    if kind == ACKERMANN:
        return make(
            ACKERMANN,
            header=make("std_msgs/msg/Header", stamp=now, frame_id=frame),
            drive=make(
                "ackermann_msgs/msg/AckermannDrive",
                steering_angle=command.steering_angle,
                steering_angle_velocity=command.steering_rate,
                speed=command.speed,
                acceleration=command.acceleration,
                jerk=0.0,
            ),
        )
    return make(
        CONTROL,
        stamp=now,
        control_time=now,
        lateral=make(
            "autoware_control_msgs/msg/Lateral",
            stamp=now,
            control_time=now,
            steering_tire_angle=command.steering_angle,
            steering_tire_rotation_rate=command.steering_rate,
            is_defined_steering_tire_rotation_rate=True,
        ),
        longitudinal=make(
            "autoware_control_msgs/msg/Longitudinal",
            stamp=now,
            control_time=now,
            velocity=command.speed,
            acceleration=command.acceleration,
            jerk=0.0,
            is_defined_acceleration=True,
            is_defined_jerk=False,
        ),
    )
