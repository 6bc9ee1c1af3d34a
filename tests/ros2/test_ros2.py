# mypy: disable-error-code="arg-type"
"""The adapter to ROS 2: bytes against another CDR library, and a drive over zenoh."""

# ruff: noqa: E402 - the libraries of the extra may be missing
from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import zenoh
from typer.testing import CliRunner

for name in ("rosbags", "ruamel.yaml", "xxhash", "pycdr2"):
    pytest.importorskip(name, reason=f"{name} comes with `make setup`")

from egp_service import Controller, Plant, shipped
from egp_service._core import EgpError, InvalidArgumentError
from egp_service.cli import app, signals
from egp_service.control.endpoints import free_endpoint
from egp_service.control.router import Router
from egp_service.ros2 import messages, node
from egp_service.ros2.autoware import AutowareError, map_parameters, read_parameters
from egp_service.ros2.conversion import (
    Command,
    PathError,
    message_of,
    path_of,
    positions_of,
    state_of,
)
from egp_service.ros2.driving import Drive
from egp_service.ros2.rmw_zenoh import (
    Topic,
    check_topic,
    encode_attachment,
    endpoint_token,
    gid,
    node_token,
)
from patience import ATTEMPTS, PATIENCE
from ros2 import idl, vehicle

if TYPE_CHECKING:
    from collections.abc import Callable

    from egp_service import Path as Road

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
    for topic in ("odom", "/a//b", "/a*"):
        with pytest.raises(InvalidArgumentError):
            check_topic(topic)


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
    assert f"No program listens at {endpoint}" in " ".join(result.output.split())
    assert isinstance(result.exception, EgpError)
    message = str(result.exception)
    assert f"no router of rmw_zenoh at {endpoint}" in message
    assert "orchestrator" not in message  # the place in zenoh's source


def test_the_router_is_at_the_endpoints_of_a_configuration_of_zenoh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []

    def refuse(config: zenoh.Config, _: float) -> None:
        opened.extend(json.loads(config.get_json("connect/endpoints")))
        raise zenoh.ZError("refused")

    monkeypatch.setattr(node, "open_session", refuse)
    file = tmp_path / "zenoh.json5"
    file.write_text('{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:9"]}}')
    command = ["ros2", "--zenoh", str(file)]
    told = str(CliRunner().invoke(app, command).exception)
    assert told.startswith(f"no router of rmw_zenoh at the endpoints of {file}: refused")
    CliRunner().invoke(app, [*command, "--router", "tcp/127.0.0.1:10"])
    assert opened == ["tcp/127.0.0.1:9", "tcp/127.0.0.1:10"]


def test_a_signal_that_came_in_a_function_that_zenoh_calls_ends_the_drive(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Driven:
        """A vehicle whose first period follows a signal that could not raise anything."""

        problem = ""

        def __init__(self, *_: object) -> None:
            pass

        def run(self, observe: Callable[[None], None], _: object) -> None:
            monkeypatch.setattr(signals, "_received", [signal.SIGTERM])
            observe(None)
            raise EgpError("driven on")

    monkeypatch.setattr(node, "Node", lambda *_: nullcontext())
    monkeypatch.setattr("egp_service.ros2.driving.Vehicle", Driven)
    assert CliRunner().invoke(app, ["ros2"]).exit_code == 128 + signal.SIGTERM


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


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("--odometry /odom --path /odom", "--odometry and --path are both /odom"),
        ("--ackermann /x --control /x", "--ackermann and --control are both /x"),
        ("--path plan", "--path: topic 'plan': expected a fully qualified name"),
        ("--odometry=", "--odometry: topic '': expected a fully qualified name"),
        ("--seconds nan", "--seconds is nan"),
        ("--seconds -1", "--seconds is -1"),
    ],
)
def test_what_cannot_be_driven_with_is_an_error_before_the_node_starts(
    options: str, told: str
) -> None:
    result = CliRunner().invoke(app, ["ros2", *options.split()])
    assert told in str(result.exception)


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
