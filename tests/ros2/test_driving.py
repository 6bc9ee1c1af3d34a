# mypy: disable-error-code="arg-type"
"""A vehicle behind topics without a network: what it does with messages of every kind."""

# ruff: noqa: E402 - the libraries of the extra may be missing
from __future__ import annotations

import errno
import io
import sys
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import MagicMock, Mock

import numpy as np
import pytest

for name in ("rosbags", "ruamel.yaml", "xxhash", "pycdr2"):
    pytest.importorskip(name, reason=f"{name} comes with `make setup`")

from egp_service import Controller, Plant, shipped
from egp_service._core import EgpError
from egp_service.cli.commands.ros2 import ros2
from egp_service.control import endpoints
from egp_service.ros2 import driving, messages, node
from egp_service.ros2.driving import Drive, Vehicle
from egp_service.ros2.messages import ODOMETRY
from ros2 import idl, vehicle
from ros2.topics import Topics

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from egp_service.control.step import Step
    from ros2.topics import Clock


def test_measurements_that_cannot_be_used_stop_the_vehicle_with_its_wheels_held(
    clock: Clock,
) -> None:
    car = Plant().parameters
    topics = Topics(clock)
    state = np.array([0.0, 0.3, 8.0, 0.0, 0.0, 0.0, 0.1])
    points = [(10.0 * k, 0.0) for k in range(20)]
    header = idl.Header(idl.Time(), "map")
    poses = [idl.PoseStamped(header, vehicle.pose(x, y, 0.0)) for x, y in points]
    straight = messages.decode(idl.Path(header, poses).serialize(), messages.PATH)

    def odometry(state: NDArray[np.float64]) -> object:
        return messages.decode(vehicle.odometry(state, 1.0), messages.ODOMETRY)

    settings = Drive(car, 1.0, odometry="odom", path="plan", steering="steering", control=None)

    def with_quaternion(**components: float) -> object:
        message: Any = odometry(state)
        for name, value in components.items():
            setattr(message.pose.pose.orientation, name, value)
        return message

    cases: list[tuple[str, Any]] = [
        *(("steering", SimpleNamespace(steering_tire_angle=a)) for a in (np.nan, np.inf, -5.0)),
        *(("odom", np.where(np.arange(7) == k, bad, state))
          for k, bad in ((0, np.nan), (0, 1e300), (3, np.nan), (4, np.nan), (4, 1e300))),
        *(("odom", {name: bad}) for name, bad in (("x", 1e200), ("y", np.nan), ("w", np.inf))),
    ]  # fmt: skip
    for topic, broken in cases:
        with Controller(shipped.DEMO_LIBRARY, gate=car.gate_limits()) as controller:
            driven = Vehicle(topics, controller, settings)
            topics.commands.clear()
            modes: list[str | None] = []
            topics.messages.update(
                plan=straight, odom=odometry(np.full(7, np.nan)),
                steering=SimpleNamespace(steering_tire_angle=0.1),
            )  # fmt: skip

            def observe(step: Step | None, modes: list[str | None] = modes) -> None:
                modes.append(None if step is None else step.mode)

            driven.run(observe, 0.01)
            assert set(modes) == {None}, "without a usable state there is no reference"
            report = SimpleNamespace(steering_tire_angle=0.1)
            topics.messages.update(odom=odometry(state), steering=report)
            driven.run(observe, 0.01)
            if isinstance(broken, dict):
                newest = with_quaternion(**broken)
            else:
                newest = broken if topic == "steering" else odometry(broken)
            topics.messages.update({"odom": odometry(state), "steering": report, topic: newest})
            driven.run(observe, 0.01)
        assert modes[-2:] == ["normal", "stop"], (topic, modes)
        angles = [command.drive.steering_angle for command in topics.commands]
        assert len(angles) == 2
        assert np.isfinite(angles).all()
        assert angles[-1] == pytest.approx(0.1, abs=0.02)
        assert topics.commands[-1].drive.speed == 0.0


def straight(frame: str, length: int = 200) -> object:
    header = idl.Header(idl.Time(), frame)
    poses = [idl.PoseStamped(header, vehicle.pose(float(x), 0.0, 0.0)) for x in range(length)]
    return messages.decode(idl.Path(header, poses).serialize(), messages.PATH)


def drive_topics(
    clock: Clock, settings: Drive, rounds: Sequence[dict[str, object]]
) -> tuple[list[str | None], str, list[Any]]:
    """Drive some periods with the messages of each round; give modes, problem and commands."""
    topics = Topics(clock)
    modes: list[str | None] = []
    with Controller(shipped.DEMO_LIBRARY, gate=settings.vehicle.gate_limits()) as controller:
        driven = Vehicle(topics, controller, settings)
        for received in rounds:
            topics.messages.update(received)
            driven.run(lambda step: modes.append(step and step.mode), 0.03)
    return modes, driven.problem, topics.commands


def test_odometry_that_hangs_and_steering_that_is_silent_stop_the_vehicle(clock: Clock) -> None:
    car = Plant().parameters
    names = {"odometry": "odom", "path": "plan", "control": None, "silence": 0.1}
    frozen = messages.decode(vehicle.odometry(np.array([9.0, 0, 8, 0, 0, 0, 0]), 1.0), ODOMETRY)
    rounds = [{"plan": straight("map"), "odom": frozen}, *({"odom": frozen} for _ in range(8))]
    modes, problem, _ = drive_topics(clock, Drive(car, 1.0, **names), rounds)
    assert "normal" in modes
    assert modes[-1] == "stop"
    assert problem == "the time stamp of the odometry does not advance"
    modes, _, commands = drive_topics(clock, Drive(car, 1.0, steering="steering", **names), rounds)
    assert set(modes) == {None}, "the steering angle was never reported"
    assert commands == []


def test_a_path_is_driven_in_its_own_frame_and_to_its_end(clock: Clock) -> None:
    car = Plant().parameters

    def odometry(x: float) -> dict[str, object]:
        state = np.array([x, 0.0, 8.0, 0.0, 0.0, 0.0, 0.0])
        return {"odom": messages.decode(vehicle.odometry(state, 1.0), ODOMETRY)}

    settings = Drive(car, 1.0, odometry="odom", path="plan", control=None)
    wrong = {"plan": straight("base_link")}
    refused = "the path is in the frame 'base_link': expected that of the odometry, 'map'"
    for rounds in ([odometry(9.0), wrong, odometry(9.2)], [wrong, odometry(9.0), odometry(9.2)]):
        modes, problem, _ = drive_topics(clock, settings, rounds)
        assert set(modes) == {None}
        assert problem == refused
    # The same poses in the right frame are driven.
    right = [wrong, odometry(9.0), {"plan": straight("map")}, odometry(9.2), odometry(9.4)]
    modes, problem, _ = drive_topics(clock, settings, right)
    assert (modes[-1], problem) == ("normal", "")
    # A path that cannot be used is named until the one in use is published again.
    right += [{"plan": straight("map", 2)}, odometry(9.6)]
    modes, problem, _ = drive_topics(clock, settings, right)
    assert modes[-1] == "normal"
    assert "path with 2 different poses" in problem
    modes, problem, _ = drive_topics(
        clock, settings, [*right, {"plan": straight("map")}, odometry(9.8)]
    )
    assert (modes[-1], problem) == ("normal", "")
    begin = {"plan": straight("map"), **odometry(190.0)}
    modes, problem, commands = drive_topics(
        clock, settings, [begin, odometry(190.2), odometry(190.4)]
    )
    assert problem == ""
    assert modes[-1] == "normal"
    assert commands[-1].drive.acceleration < -1.0, "9 m before the end of the path"


def test_a_path_without_speeds_is_named(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driving, "SpeedProfile", Mock(side_effect=EgpError("no speed")))
    settings = Drive(Plant().parameters, 1.0, path="plan")
    _, problem, _ = drive_topics(clock, settings, [{"plan": straight("map")}, {}])
    assert problem == "path of 200 poses: no speed"


CAR = Plant().parameters
NAMES: dict[str, Any] = {"odometry": "odom", "path": "plan", "control": None}


def odometry(x: float, **stamp: int) -> dict[str, object]:
    """Give an odometry at `x` of the straight road; `stamp` is `sec`, `nanosec` in place of now."""
    state = np.array([x, 0.0, 8.0, 0.0, 0.0, 0.0, 0.0])
    message = messages.decode(vehicle.odometry(state, 1.0), ODOMETRY)
    for name, value in stamp.items():
        setattr(message.header.stamp, name, value)
    return {"odom": message}


def test_a_clock_that_was_set_back_is_used_from_its_second_stamp_on(clock: Clock) -> None:
    settings = Drive(CAR, 1.0, **NAMES)
    rounds = [
        {"plan": straight("map"), **odometry(9.0)},
        odometry(9.2, sec=2**31 - 1),
        odometry(9.4, sec=5),
    ]
    modes, problem, _ = drive_topics(clock, settings, rounds)
    assert problem == "the time stamp of the odometry does not advance"
    modes, problem, _ = drive_topics(clock, settings, [*rounds, odometry(9.6, sec=6)])
    assert (modes[-1], problem) == ("normal", "")
    # Messages that only came late are not those of a clock that was set back.
    late = [odometry(9.1, sec=9, nanosec=850_000_000), odometry(9.15, sec=9, nanosec=900_000_000)]
    begun = {"plan": straight("map"), **odometry(9.2, sec=10, nanosec=0)}
    _, problem, _ = drive_topics(clock, settings, [begun, *late])
    assert problem == "the time stamp of the odometry does not advance"
    # Two stamps that come in turn do not advance.
    frozen = [odometry(9.6, sec=5, nanosec=k % 2) for k in range(12)]
    modes, problem, _ = drive_topics(clock, settings, [rounds[0], *frozen])
    assert modes[-1] == "stop"
    assert problem == "the time stamp of the odometry does not advance"


def test_a_steering_message_that_cannot_be_read_is_named_until_one_can(clock: Clock) -> None:
    settings = Drive(CAR, 1.0, steering="steering", **NAMES)
    begin = {"plan": straight("map"), "steering": SimpleNamespace(steering_tire_angle=0.0)}
    bad = {"steering": messages.MessageError("no report")}
    rounds = [{**begin, **odometry(9.0)}, {**bad, **odometry(9.2)}]
    modes, problem, _ = drive_topics(clock, settings, rounds)
    assert problem == "no report"
    good = {"steering": SimpleNamespace(steering_tire_angle=0.0), **odometry(9.4)}
    modes, problem, _ = drive_topics(clock, settings, [*rounds, good])
    assert (modes[-1], problem) == ("normal", "")


def test_a_path_beyond_what_requests_can_state_does_not_replace_the_present_one(
    clock: Clock,
) -> None:
    far: Any = straight("map")
    for pose in far.poses:
        pose.pose.position.y = 2e7
    rounds = [{"plan": straight("map"), **odometry(9.0)}, {"plan": far}, odometry(9.4)]
    modes, problem, _ = drive_topics(clock, Drive(CAR, 1.0, **NAMES), rounds)
    assert modes[-1] == "normal"
    assert problem.startswith("the path has a coordinate of 2e+07 m: expected at most 1e+07 m")


def test_a_reference_that_cannot_be_used_stops_the_vehicle_and_is_named(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    topics, modes = Topics(clock), list[str | None]()
    with Controller(shipped.DEMO_LIBRARY, gate=CAR.gate_limits()) as controller:
        driven = Vehicle(topics, controller, Drive(CAR, 1.0, **NAMES))
        for bad in (False, True):
            topics.messages.update(plan=straight("map"), **odometry(9.0 + 0.2 * bad))
            if bad:
                broken = Mock(side_effect=EgpError("no reference"))
                monkeypatch.setattr(driving, "horizon_reference", broken)
            driven.run(lambda step: modes.append(step and step.mode), 0.03)
    assert (modes[-1], driven.problem) == ("stop", "no reference")
    assert len(topics.commands) == sum(mode is not None for mode in modes)
    assert topics.commands[-1].drive.speed == 0.0
    assert topics.commands[-1].drive.acceleration < 0.0


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left"), BrokenPipeError()])
def test_a_status_that_cannot_be_written_does_not_end_the_drive(
    monkeypatch: pytest.MonkeyPatch, error: OSError
) -> None:
    periods: list[Step | None] = []

    class Broken(io.StringIO):
        def write(self, _: str) -> int:
            """Fail."""
            raise error

    class Driven:
        problem = ""

        def __init__(self, *_: object) -> None:
            pass

        def run(self, observe: Callable[[Step | None], None], seconds: float | None) -> None:
            """Drive two periods."""
            assert seconds == 1.0
            monkeypatch.setattr(sys, "stderr", Broken())
            for self.problem in ("", "a path"):
                observe(None)
                periods.append(None)

    monkeypatch.setattr(driving, "Vehicle", Driven)
    monkeypatch.setattr(node, "Node", MagicMock())
    monkeypatch.setattr(endpoints, "why_unreachable", lambda _: None)
    ros2(seconds=1.0)
    assert len(periods) == 2
