"""Drives a vehicle of ROS 2: odometry and path in, commands out."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import SpeedProfile, horizon_reference
from egp_service.quantities import DELTA, NX, POSITION, V_X
from egp_service.ros2.conversion import (
    Command,
    PathError,
    extrapolated,
    message_of,
    path_of,
    state_of,
)
from egp_service.ros2.messages import ACKERMANN, CONTROL, ODOMETRY, PATH, STEERING, MessageError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from egp_service._core import Path, VehicleParameters
    from egp_service.control.step import Step, StepController
    from egp_service.ros2.node import Node

# Part of the period by which an odometry message may be early.
_EARLY: Final = 0.25
_FIRST_DEADLINE: Final = 2.0
# rad; requests allow no larger steering angle.
_LARGEST_ANGLE: Final = 1.6
# m, m/s and so on; no state of a vehicle on a map has a larger component.
_LARGEST: Final = 1e6


@dataclass(frozen=True, slots=True)
class Drive:
    """What is driven, how fast, and on which topics."""

    vehicle: VehicleParameters
    to_centre: float
    """Distance of the centre of mass ahead of the odometry's child frame, m."""
    friction: float = 0.5
    """Friction coefficient for which the speed is planned."""
    grip: float = 0.8
    """Used part of that friction."""
    v_max: float = 10.0
    """m/s."""
    silence: float = 0.2
    """Time without odometry after which the vehicle is stopped, s."""
    odometry: str = "/localization/kinematic_state"
    path: str = "/planning/path"
    steering: str | None = None
    """Topic of the measured steering angle; without it the commanded angle counts as measured."""
    ackermann: str | None = "/drive"
    control: str | None = "/control/command/control_cmd"


def _usable(x: NDArray[np.float64]) -> bool:
    """Whether all components are numbers that a vehicle can have, which NaN is not."""
    return bool((np.abs(x) <= _LARGEST).all() and abs(x[DELTA]) <= _LARGEST_ANGLE)


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
        self._path: Path | None = None
        self._profile: SpeedProfile | None = None
        self._s: float | None = None
        self._x = np.zeros(NX)
        # The last state that was usable, from which the reference starts.
        self._known: NDArray[np.float64] | None = None
        self._seen = -np.inf
        # The steering angle as it was measured, and the last one that is an angle of wheels.
        self._measured = self._delta = 0.0
        self._frame = ""
        self._first = True
        self.problem = ""
        """Why the newest message could not be used; empty if it could."""

    def run(self, observe: Callable[[Step | None], None], seconds: float | None = None) -> None:
        """Drive until `seconds` have passed, or until an exception such as a signal ends it.

        `observe` is called in every period with its step, and with `None` while odometry or path
        were never received, in which case nothing is published. A period begins when odometry
        arrives; if none does, after 1.25 periods with the extrapolated state, and from `silence`
        seconds on with a stop, which lasts until the program is started again.
        """
        dt = self._controller.dt
        begun = last = time.monotonic()
        while seconds is None or last - begun < seconds:
            self._wait(last + (1.0 - _EARLY) * dt, last + (1.0 + _EARLY) * dt)
            now = time.monotonic()
            x = self._state(now, now - last)
            last = now
            if x is not None and _usable(x):
                self._known = x
            if x is None or self._known is None or self._path is None or self._profile is None:
                observe(None)
                continue
            observe(self._period(x, self._known, self._path, self._profile))

    def _wait(self, earliest: float, latest: float) -> None:
        """Return with the first message after `earliest`, or at `latest`."""
        time.sleep(max(0.0, earliest - time.monotonic()))
        self._node.arrived.clear()
        before = self._seen
        while (left := latest - time.monotonic()) > 0.0:
            self._receive()
            if self._seen > before:
                return
            self._node.arrived.wait(left)
            self._node.arrived.clear()
        self._receive()

    def _receive(self) -> None:
        """Read what has arrived; what cannot be used is named in `problem`."""
        try:
            if self._angles is not None and (angle := self._angles.take()) is not None:
                self._measured = float(angle[0].steering_tire_angle)
                if abs(self._measured) <= _LARGEST_ANGLE:
                    self._delta = self._measured
            if (newest := self._paths.take()) is not None:
                self._path = path_of(newest[0], self._drive.friction)
                self._profile = SpeedProfile(
                    self._path, self._drive.vehicle, self._drive.grip, self._drive.v_max
                )
                self._s = None
            if (odometry := self._odometry.take()) is not None:
                message, self._seen = odometry
                self._frame = message.child_frame_id
                self._x = state_of(message, self._measured, self._drive.to_centre)
                self.problem = "" if _usable(self._x) else "the measured state cannot be used"
        except (MessageError, PathError) as error:
            self.problem = str(error)

    def _state(self, now: float, elapsed: float) -> NDArray[np.float64] | None:
        """Return the state of now; not a number after a silence, `None` before the first."""
        if np.isinf(self._seen):
            return None
        age = now - self._seen
        if age > self._drive.silence:
            return np.full(NX, np.nan)
        if age > self._controller.dt:
            self._x = extrapolated(self._x, elapsed)
            self._x[DELTA] = self._measured
        return self._x

    def _period(
        self,
        x: NDArray[np.float64],
        known: NDArray[np.float64],
        path: Path,
        profile: SpeedProfile,
    ) -> Step:
        """Compute the step of a period, and publish its command.

        A state that cannot be used makes the driver stop; the reference of `known`, the last one
        that could, then has no meaning. The commanded angle is that of the last angle of wheels.
        """
        controller, drive = self._controller, self._drive
        hint = path.project(known[POSITION]).s if self._s is None else self._s
        reference, widths, projection = horizon_reference(
            path, profile, known, controller.dt, controller.horizon, hint
        )
        self._s = projection.s
        step = controller.step(
            x, reference, widths, deadline=_FIRST_DEADLINE if self._first else None
        )
        self._first = False
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
