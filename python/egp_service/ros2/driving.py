"""Drives a vehicle of ROS 2: odometry and path in, commands out."""

from __future__ import annotations

import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import (
    EgpError,
    InvalidArgumentError,
    SpeedProfile,
    horizon_reference,
)
from egp_service.quantities import DELTA, NX, POSITION, PSI, V_X
from egp_service.ros2.conversion import (
    LARGEST,
    Command,
    PathError,
    extrapolated,
    message_of,
    path_of,
    positions_of,
    state_of,
)
from egp_service.ros2.messages import ACKERMANN, CONTROL, ODOMETRY, PATH, STEERING, MessageError

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from numpy.typing import NDArray

    from egp_service._core import Path, VehicleParameters
    from egp_service.control.step import Step, StepController
    from egp_service.ros2.node import Node

# Parts of the control period by which odometry that comes once in each period may be early or late
# to begin one. After a lost message a period begins late, and the next message is early by as much.
_EARLY, _LATE = 0.3, 0.2
# Largest part of the control period by which the mean time between messages of such odometry
# differs from it, and the number of these times.
_DIFFERENCE, _TIMES = 0.05, 8
_FIRST_DEADLINE: Final = 2.0
# rad; requests allow no larger steering angle.
_LARGEST_ANGLE: Final = 1.6
# Smallest and largest square of the norm of an orientation's quaternion.
_UNIT: Final = (0.9, 1.1)
# m; a heading error of a radian counts as this distance where a new path is joined.
_TURN_DISTANCE: Final = 5.0


# Largest values of a drive. After a longer silence than this one a vehicle has driven too far.
_MOST: Final = {"friction": 2.0, "grip": 1.0, "v_max": 100.0, "silence": 2.0}


@dataclass(frozen=True, slots=True)
class Drive:
    """What is driven, how fast, and on which topics.

    Raises:
        InvalidArgumentError: for a number out of its range, and without a topic for commands.

    """

    vehicle: VehicleParameters
    to_centre: float
    """Distance of the centre of mass ahead of the odometry's child frame, m."""
    friction: float = 0.5
    """Friction coefficient for which the speed is planned."""
    grip: float = 0.8
    """Used part of that friction."""
    v_max: float = 10.0
    """Largest planned speed, m/s."""
    silence: float = 0.2
    """Time without odometry, or reports of `steering`, after which the vehicle is stopped, s; at
    most 2."""
    odometry: str = "/localization/kinematic_state"
    path: str = "/planning/path"
    steering: str | None = None
    """Topic of the measured steering angle; without it the commanded angle counts as measured."""
    ackermann: str | None = "/drive"
    control: str | None = "/control/command/control_cmd"

    def __post_init__(self) -> None:
        """Check the numbers and the topics."""
        for name, most in _MOST.items():
            value = getattr(self, name)
            if not 0.0 < value <= most:
                raise InvalidArgumentError(
                    f"{name}: expected a number above 0 and at most {most:g}, got {value}"
                )
        if self.ackermann is None and self.control is None:
            raise InvalidArgumentError(
                "there is no topic for commands: name one for `ackermann` or `control`"
            )


@dataclass(frozen=True, slots=True)
class _Course:
    """A path that was received, with its speeds."""

    points: NDArray[np.float64]
    path: Path
    profile: SpeedProfile
    frame: str


def _usable(x: NDArray[np.float64]) -> bool:
    """Whether all components are numbers that a vehicle can have, which NaN is not."""
    return bool((np.abs(x) <= LARGEST).all() and abs(x[DELTA]) <= _LARGEST_ANGLE)


class Vehicle:
    """The vehicle behind the topics, driven by a controller in its periods."""

    def __init__(self, node: Node, controller: StepController, drive: Drive) -> None:
        """Declare publishers and subscriptions."""
        self._node, self._controller, self._drive = node, controller, drive
        self._odometry = node.subscribe(drive.odometry, ODOMETRY)
        self._paths = node.subscribe(drive.path, PATH)
        self._angles = None if drive.steering is None else node.subscribe(drive.steering, STEERING)
        topics = {ACKERMANN: drive.ackermann, CONTROL: drive.control}
        self._publish = [
            (kind, node.publisher(topic, kind))
            for kind, topic in topics.items()
            if topic is not None
        ]
        self._course: _Course | None = None
        # The path that is read in another thread, because a long one takes several periods, and the
        # one that was read, until the odometry's frame is known.
        self._reading: Future[_Course | None] | None = None
        self._next: _Course | None = None
        self._s: float | None = None
        self._x = np.zeros(NX)
        # The last state that was usable, from which the reference starts.
        self._known: NDArray[np.float64] | None = None
        self._seen = self._reported = -np.inf
        # When the last messages of odometry came.
        self._arrivals: deque[float] = deque(maxlen=_TIMES + 1)
        # The stamp of the newest odometry that was used, and that of one that was refused after it.
        self._stamp = (0, 0)
        self._refused: tuple[int, int] | None = None
        # The steering angle as it was measured, and the last one that is an angle of wheels.
        self._measured = self._delta = 0.0
        self._frame = self._map_frame = ""
        self._first = True
        self._problems: dict[str, str] = {}

    @property
    def problem(self) -> str:
        """Why the newest messages could not be used; empty if they could."""
        return "; ".join(self._problems.values())

    def run(self, observe: Callable[[Step | None], None], seconds: float | None = None) -> None:
        """Drive until `seconds` have passed, or until an exception such as a signal ends it.

        `observe` is called in every period with its step, and with `None` while odometry, path or
        the measured steering angle were never received, in which case nothing is published. A
        period begins one control period after the last one, with the state of the newest odometry
        extrapolated to its time. If odometry comes about once in each control period, a period
        begins with its arrival. `silence` seconds without odometry are a stop, which lasts until
        the program is started again.
        """
        dt = self._controller.dt
        begun = last = time.monotonic()
        with ThreadPoolExecutor(max_workers=1) as reader:
            while seconds is None or last - begun < seconds:
                due = self._wait(reader, last)
                now = time.monotonic()
                # What is late by more is not made up for by shorter periods.
                last = due if now - due < _LATE * dt else now
                x = self._state(now)
                if x is not None and _usable(x):
                    self._known = x
                if x is None or self._known is None or self._course is None:
                    observe(None)
                    continue
                observe(self._period(x, self._known, self._course))

    def _wait(self, reader: ThreadPoolExecutor, last: float) -> float:
        """Wait for the period after the one of `last`, read messages, and return when it was due.

        If odometry comes about once in each period, that is when the first message comes which is
        not too early, but not too late either.
        """
        dt = self._controller.dt
        earliest = latest = last + dt
        if self._comes_once_in_a_period(last):
            earliest, latest = last + (1.0 - _EARLY) * dt, last + (1.0 + _LATE) * dt
        while True:
            self._node.arrived.clear()
            self._receive(reader)
            if self._seen > earliest:
                return min(self._seen, latest)
            if (left := latest - time.monotonic()) <= 0.0:
                return latest
            self._node.arrived.wait(left)

    def _comes_once_in_a_period(self, now: float) -> bool:
        """Whether odometry comes about once in each control period, also now."""
        dt, arrivals = self._controller.dt, self._arrivals
        if len(arrivals) <= _TIMES or now - arrivals[-1] > 1.5 * dt:
            return False
        return abs((arrivals[-1] - arrivals[0]) / _TIMES - dt) <= _DIFFERENCE * dt

    def _receive(self, reader: ThreadPoolExecutor) -> None:
        """Read what has arrived; what cannot be used is named in `problem`."""
        for name, receive in (
            ("steering", self._receive_angle),
            ("path", lambda: self._receive_path(reader)),
            ("odometry", self._receive_odometry),
        ):
            try:
                receive()
            except (MessageError, PathError) as error:
                self._problems[name] = str(error)

    def _receive_angle(self) -> None:
        if self._angles is None or (newest := self._angles.take()) is None:
            return
        message, self._reported = newest
        self._measured = float(message.steering_tire_angle)
        if abs(self._measured) <= _LARGEST_ANGLE:
            self._delta = self._measured
            self._problems.pop("steering", None)

    def _receive_path(self, reader: ThreadPoolExecutor) -> None:
        """Use a path once it has been read and there is odometry; let the next one be read."""
        if self._reading is not None and not self._reading.done():
            return
        read, self._reading = self._reading, reader.submit(self._read_path)
        self._next = (read.result() if read is not None else None) or self._next
        if self._next is None or np.isinf(self._seen):
            return
        course, self._next = self._next, None
        if self._map_frame and course.frame and course.frame != self._map_frame:
            raise PathError(
                f"the path is in the frame {course.frame!r}: expected that of the odometry, "
                f"{self._map_frame!r}"
            )
        self._problems.pop("path", None)
        if course is not self._course:
            self._course, self._s = course, None

    def _read_path(self) -> _Course | None:
        """Return the path of the newest message, or the present one if its poses are the same."""
        if (newest := self._paths.take()) is None:
            return None
        message, _ = newest
        drive, points, present = self._drive, positions_of(message), self._course
        if present is not None and np.array_equal(points, present.points):
            return present
        path = path_of(points, drive.friction)
        try:
            profile = SpeedProfile(
                path,
                drive.vehicle,
                drive.grip,
                drive.v_max,
                end_speed=None if path.closed else 0.0,
            )
        except EgpError as error:
            raise PathError(f"path of {len(points)} poses: {error}") from error
        return _Course(points, path, profile, message.header.frame_id)

    def _receive_odometry(self) -> None:
        if (newest := self._odometry.take()) is None:
            return
        message, arrival = newest
        stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
        if stamp != (0, 0):
            # A clock that was set back advances again with the second stamp.
            # A message that only came late is behind by less than a silence.
            behind = self._stamp[0] - stamp[0] + 1e-9 * (self._stamp[1] - stamp[1])
            later = self._refused is not None and self._refused < stamp
            set_back = later and behind > self._drive.silence
            if stamp <= self._stamp and not set_back:
                self._refused = stamp
                self._problems["odometry"] = "the time stamp of the odometry does not advance"
                return
            self._stamp, self._refused = stamp, None
        self._seen = arrival
        self._arrivals.append(arrival)
        self._frame, self._map_frame = message.child_frame_id, message.header.frame_id
        self._x = state_of(message, self._measured, self._drive.to_centre)
        q = message.pose.pose.orientation
        # Products of large numbers are infinite, while their powers raise `OverflowError`.
        if not _UNIT[0] <= q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w <= _UNIT[1]:
            self._x[PSI] = np.nan
        if _usable(self._x):
            self._problems.pop("odometry", None)
        else:
            self._problems["odometry"] = "the measured state cannot be used"

    def _state(self, now: float) -> NDArray[np.float64] | None:
        """Return the state of now; not a number after a silence, `None` before the first.

        The steering angle is the one that was measured last.
        """
        reported = now if self._angles is None else self._reported
        if np.isinf(self._seen) or np.isinf(reported):
            return None
        age = now - self._seen
        if max(age, now - reported) > self._drive.silence:
            return np.full(NX, np.nan)
        x = extrapolated(self._x, age) if _usable(self._x) else self._x.copy()
        x[DELTA] = self._measured
        return x

    def _period(
        self,
        x: NDArray[np.float64],
        known: NDArray[np.float64],
        course: _Course,
    ) -> Step:
        """Compute the step of a period, and publish its command.

        A state that cannot be used makes the driver stop; the reference of `known`, the last one
        that could, then has no meaning. So does a reference that cannot be used. The commanded
        angle is that of the last angle of wheels.
        """
        controller, drive = self._controller, self._drive
        try:
            step = self._step(x, known, course)
            if step.mode != "stop":  # the first cause of a stop remains its reason
                self._problems.pop("reference", None)
        except EgpError as error:
            self._problems["reference"] = str(error)
            step = controller.step(np.full(NX, np.nan), np.zeros((controller.horizon + 1, 4)))
        acceleration, rate = float(step.u[0]) / drive.vehicle.mass, float(step.u[1])
        limit = drive.vehicle.steering_angle
        angle = float(np.clip(self._delta + rate * controller.dt, -limit, limit))
        if drive.steering is None:
            self._measured = self._delta = angle
        speed = max(0.0, float(known[V_X]) + acceleration * controller.dt)
        command = Command(angle, rate, 0.0 if step.mode == "stop" else speed, acceleration)
        for kind, publish in self._publish:
            publish(message_of(command, kind, time.time_ns(), self._frame))
        return step

    def _step(self, x: NDArray[np.float64], known: NDArray[np.float64], course: _Course) -> Step:
        """Compute the step for the reference that begins at the state `known`."""
        controller = self._controller
        hint = _joined(course.path, known) if self._s is None else self._s
        reference, widths, projection = horizon_reference(
            course.path, course.profile, known, controller.dt, controller.horizon, hint
        )
        self._s = projection.s
        step = controller.step(
            x, reference, widths, deadline=_FIRST_DEADLINE if self._first else None
        )
        self._first = False
        return step


def _joined(path: Path, x: NDArray[np.float64]) -> float:
    """Return the arc length where a vehicle joins a path: near it, and in its direction.

    The nearest place alone may be on another branch of a path that crosses itself.
    """
    s = np.arange(0.0, path.length, 1.0)
    p_x, p_y, yaw, *_ = path.sample(s)
    distance = np.hypot(p_x - x[POSITION[0]], p_y - x[POSITION[1]])
    turn = np.abs(np.angle(np.exp(1j * (yaw - x[PSI]))))
    return float(s[np.argmin(distance + _TURN_DISTANCE * turn)])
