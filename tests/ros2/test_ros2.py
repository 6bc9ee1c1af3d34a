# mypy: disable-error-code="arg-type"
"""The adapter to ROS 2: bytes against another CDR library, and a drive over zenoh."""

# ruff: noqa: E402 - the libraries of the extra may be missing
from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import numpy as np
import pytest
from typer.testing import CliRunner

for name in ("rosbags", "ruamel.yaml", "xxhash", "pycdr2"):
    pytest.importorskip(name, reason=f"{name} comes with `make setup`")

from egp_service import Controller, Plant, shipped
from egp_service._core import EgpError, InvalidArgumentError
from egp_service.cli import app
from egp_service.control.endpoints import free_endpoint
from egp_service.control.router import Router
from egp_service.ros2 import driving, messages, node
from egp_service.ros2.autoware import AutowareError, map_parameters, read_parameters
from egp_service.ros2.conversion import (
    Command,
    PathError,
    message_of,
    path_of,
    positions_of,
    state_of,
)
from egp_service.ros2.driving import Drive, Vehicle
from egp_service.ros2.messages import ODOMETRY
from egp_service.ros2.rmw_zenoh import (
    Topic,
    encode_attachment,
    endpoint_token,
    gid,
    node_token,
)
from patience import ATTEMPTS, PATIENCE
from ros2 import idl, vehicle
from ros2.topics import Clock, Reader, Topics

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from egp_service import Path as Road
    from egp_service.control.step import Step

TESTS = Path(__file__).parents[1]
# From the design document of rmw_zenoh.
STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def test_keys_and_tokens_are_those_of_the_design_document() -> None:
    chatter = Topic(2, "/robot1/chatter", "std_msgs/msg/String")
    assert chatter.key == f"2/robot1/chatter/std_msgs::msg::dds_::String_/{STRING}"
    assert Topic(7, "/odom", messages.ODOMETRY).key == vehicle.ODOMETRY
    session = "aac3178e146ba6f1fc6e6a4085e77f21"
    assert node_token(2, session, "listener") == f"@ros2_lv/2/{session}/0/0/NN/%/%/listener"
    token = endpoint_token(
        Topic(2, "/chatter", "std_msgs/msg/String"),
        session, "listener", entity=10, kind="MS", depth=10,
    )  # fmt: skip
    assert token == (
        f"@ros2_lv/2/{session}/0/10/MS/%/%/listener/%chatter/std_msgs::msg::dds_::String_/"
        f"{STRING}/::,10:,:,:,,"
    )
    # XXH3 of 128 bits of the empty text is 99aa06d3014798d86001c324468d497f.
    assert gid("").hex() == "7f498d4624c30160d8984701d306aa99"
    for domain, topic in ((233, "/odom"), (-1, "/odom"), (0, "odom"), (0, "/a//b"), (0, "/a*")):
        with pytest.raises(InvalidArgumentError):
            Topic(domain, topic, messages.PATH)


def test_an_attachment_has_33_bytes_in_the_documented_order() -> None:
    data = encode_attachment(3, 1_000_000_007, bytes(range(16)))
    assert data == (
        b"\x03" + bytes(7) + b"\x07\xca\x9a\x3b" + bytes(4) + b"\x10" + bytes(range(16))
    )


def test_commands_have_the_bytes_of_another_cdr_library() -> None:
    command = Command(0.25, -0.5, 7.5, -1.25)
    time_ns = 5_000_000_009
    now = idl.Time(5, 9)
    drive = idl.AckermannDrive(0.25, -0.5, 7.5, -1.25, 0.0)
    golden = idl.AckermannDriveStamped(idl.Header(now, "base_link"), drive).serialize()
    made = message_of(command, messages.ACKERMANN, time_ns, "base_link")
    assert messages.encode(made, messages.ACKERMANN) == golden
    lateral = idl.Lateral(now, now, 0.25, -0.5, True)  # noqa: FBT003
    longitudinal = idl.Longitudinal(now, now, 7.5, -1.25, 0.0, True, False)  # noqa: FBT003
    golden = idl.Control(now, now, lateral, longitudinal).serialize()
    made = message_of(command, messages.CONTROL, time_ns, "base_link")
    # The last field is a byte, behind which libraries may pad.
    assert messages.encode(made, messages.CONTROL).rstrip(b"\0") == golden.rstrip(b"\0")


def test_odometry_of_another_cdr_library_gives_the_state() -> None:
    state = np.array([3.0, -4.0, 12.0, 2.5, 0.3, -0.2, 0.1])
    data = vehicle.odometry(state, 1.5)
    read = state_of(messages.decode(data, messages.ODOMETRY), 0.1, 1.5)
    np.testing.assert_allclose(read, state, rtol=0, atol=1e-14)
    for broken in (b"", data[:100], b"\x00\x03" + data[2:]):
        with pytest.raises(messages.MessageError):
            messages.decode(broken, messages.ODOMETRY)


def test_a_path_is_closed_if_its_ends_meet_and_needs_four_poses() -> None:
    def path(points: list[tuple[float, float]]) -> Road:
        header = idl.Header(idl.Time(), "map")
        poses = [idl.PoseStamped(header, vehicle.pose(x, y, 0.0)) for x, y in points]
        message = messages.decode(idl.Path(header, poses).serialize(), messages.PATH)
        return path_of(positions_of(message), 0.4)

    angle = np.linspace(0.0, 2.0 * np.pi, 101)
    ring = [(20.0 * float(np.cos(a)), 20.0 * float(np.sin(a))) for a in angle]
    lap = path(ring)
    assert lap.closed
    assert lap.length == pytest.approx(40.0 * np.pi, rel=1e-3)
    assert float(lap.sample(np.zeros(1))[-1][0]) == 0.4
    half = path([*ring[:50], ring[49]])
    assert not half.closed
    assert not path([(0.0, 0.0), (40.0, 0.0), (80.0, 0.0), (120.0, 0.0)]).closed
    for points in ([], ring[:1], [ring[0]] * 5):
        with pytest.raises(PathError, match="at least 4"):
            path(points)
    with pytest.raises(PathError, match=r"pose 2 of the path is at \[nan, 0.0\]: not finite"):
        path([*ring[:2], (float("nan"), 0.0), *ring[2:]])


PARAMETERS = """/**:
  ros__parameters:
    mpc_prediction_horizon: 50
    mpc_prediction_dt: 0.02
    mpc_weight_lat_error: 2.0
    mpc_weight_heading_error: 0.1
    mpc_weight_heading_error_squared_vel: 0.01
    mpc_weight_steering_input: 1.0
    mpc_weight_steer_rate: 0.1
    mpc_weight_terminal_lat_error: 4.0
    steer_rate_lim_dps_list_by_velocity: [60.0, 50.0, 40.0]
"""


def test_parameters_of_autoware_become_settings(tmp_path: Path) -> None:
    file = tmp_path / "lateral.param.yaml"
    file.write_text(PARAMETERS)
    parameters = read_parameters(file)
    mapped = map_parameters(parameters, dt=0.02)
    assert mapped.settings == {
        "horizon": 50,
        "cost": {
            "lateral": 60.0,
            "terminal": 2.0,
            "input": [0.05, pytest.approx(3.0)],
        },
    }
    assert mapped.limits == {"steering_rate": pytest.approx(np.radians(40.0))}
    assert set(mapped.ignored) == {
        "mpc_weight_heading_error",
        "mpc_weight_heading_error_squared_vel",
        "mpc_weight_steering_input",
    }
    limits = Plant().parameters.gate_limits()
    with Controller(shipped.DEMO_LIBRARY, mapped.settings, gate=limits) as controller:
        assert controller.horizon == 50
    for name, value in (("mpc_weight_lat_error", 0.0), ("mpc_prediction_dt", "fast")):
        with pytest.raises(AutowareError, match=name):
            map_parameters({**parameters, name: value}, dt=0.02)
    for text in ("a: [", "a: 1", ""):
        file.write_text(text)
        with pytest.raises(AutowareError, match=str(file)):
            read_parameters(file)


def test_a_missing_router_is_told_at_once_and_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node, "_CONNECT_SECONDS", 0.2)
    endpoint = free_endpoint()
    result = CliRunner().invoke(app, ["ros2", "--router", endpoint])
    assert f"Nobody listens at {endpoint}" in " ".join(result.output.split())
    assert isinstance(result.exception, EgpError)
    message = str(result.exception)
    assert f"no router of rmw_zenoh at {endpoint}" in message
    assert "orchestrator" not in message  # the place in zenoh's source


def test_options_of_a_service_need_one() -> None:
    result = CliRunner().invoke(app, ["ros2", "--name", "car-2"])
    assert isinstance(result.exception, EgpError)
    assert str(result.exception) == "--name can be given with --connect or --service-zenoh only"


@pytest.mark.parametrize("value", ["nan", "inf", "0", "-1", "1e9"])
@pytest.mark.parametrize("name", ["silence", "friction", "grip", "v-max"])
def test_numbers_of_a_drive_are_in_their_ranges(name: str, value: str) -> None:
    assert CliRunner().invoke(app, ["ros2", f"--{name}", value]).exit_code != 0
    field = name.replace("-", "_")
    with pytest.raises(InvalidArgumentError, match=rf"{field}: expected a number above 0"):
        Drive(Plant().parameters, 1.0, **{field: float(value)})


def test_a_drive_without_a_topic_for_commands_is_an_error() -> None:
    result = CliRunner().invoke(app, ["ros2", "--ackermann", "", "--control", ""])
    assert "no topic for commands" in str(result.exception)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Replace the time of the adapter, and the thread in which it reads paths."""
    replaced = Clock()
    monkeypatch.setattr(driving, "time", replaced)
    monkeypatch.setattr(driving, "ThreadPoolExecutor", Reader)
    return replaced


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
    cases: list[tuple[str, Any]] = [
        *(("steering", SimpleNamespace(steering_tire_angle=a)) for a in (np.nan, np.inf, -5.0)),
        *(("odom", np.where(np.arange(7) == k, bad, state))
          for k, bad in ((0, np.nan), (0, 1e300), (3, np.nan), (4, np.nan), (4, 1e300))),
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


SILENCE = 0.3


def driven_by_the_adapter() -> dict[str, Any]:
    """Run a router, the adapter and a vehicle, and give what the vehicle found."""
    endpoint = free_endpoint()
    environment = {
        **os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS), *sys.path]),
    }  # fmt: skip

    def start(*arguments: str, stdout: int | None = None) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", *arguments]
        return subprocess.Popen(command, env=environment, stdout=stdout, text=True)

    with Router([endpoint]):
        adapter = start(
            "egp_service", "ros2", "--router", endpoint, "--domain=7", "--odometry=/odom",
            "--path=/plan", "--friction=0.8", f"--silence={SILENCE}",
        )  # fmt: skip
        try:
            driven = start("ros2.vehicle", endpoint, "4.0", "0.9", stdout=subprocess.PIPE)
            said, _ = driven.communicate(timeout=2.0 * PATIENCE)
            assert driven.returncode == 0
        finally:
            adapter.terminate()
            adapter.wait(timeout=PATIENCE)
    found: dict[str, Any] = json.loads(said)
    return found


def test_a_vehicle_of_rmw_zenoh_is_driven_and_stopped_in_silence() -> None:
    for _ in range(ATTEMPTS):
        found = driven_by_the_adapter()
        # Otherwise the machine has stalled, perhaps before the first command.
        if found["gap"] < 0.5 * SILENCE and found["commands"] > 120:
            break
    kinds = sorted(token.split("/")[5] for token in found["tokens"])
    assert kinds == ["MP", "MP", "MS", "MS", "NN"]
    assert found["commands"] > 120
    assert found["sequences"]
    assert found["lateral"] < 0.5
    assert found["driven"] > 20.0
    assert not found["stopped_before_the_silence"]
    assert found["stopped_at_the_end"]
    velocity, acceleration = found["control"]
    assert velocity == 0.0
    assert acceleration < 0.0
    assert found["speed"] < found["speed_before"] - 0.5
