"""Logs in bags of ROS 1 and 2 and in MCAP files, written here by the libraries of these formats."""

from __future__ import annotations

import dataclasses
import json
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import polars as pl
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from surfaces import provenance
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service.cli import app
from egp_service.data.alignment import consecutive
from egp_service.data.dataset import Dataset
from egp_service.data.log_import import Column, import_log
from egp_service.data.recording import read_fields

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from rosbags.typesys.store import Typestore

    Array = NDArray[np.floating[Any]]

MASS: Final = 1400.0
START: Final = 1_790_000_000 * 10**9  # ns
STEER: Final = "car_msgs/msg/Steer"
COLUMNS: Final = {
    "v_x": "/car/odom/twist.twist.linear.x:m/s",
    "v_y": "/car/odom/twist/twist/linear/y:m/s",  # as PlotJuggler shows it
    "omega": "/car/imu/angular_velocity.z:rad/s",
    "delta": "/car/steer/angles[1]:deg",
    "a_x": "/car/imu/linear_acceleration.x:m/s2",
}


def signals(t: Array) -> dict[str, Array]:
    """Return a smooth drive in SI units."""
    return {
        "v_x": 15.0 + 3.0 * np.sin(0.3 * t),
        "v_y": 0.2 * np.sin(0.8 * t),
        "omega": 0.3 * np.sin(0.8 * t),
        "delta": 0.1 * np.sin(0.8 * t),
        "a_x": 0.9 * np.cos(0.3 * t),
    }


@dataclasses.dataclass
class Drive:
    """When each topic has messages, s, and what the clocks do."""

    odom: Array = dataclasses.field(default_factory=lambda: np.arange(3000) * 0.01)
    imu: Array = dataclasses.field(default_factory=lambda: 0.003 + np.arange(3000) * 0.01)
    steer: Array = dataclasses.field(default_factory=lambda: np.arange(1500) * 0.02)
    # Of the stamps in headers, s; the steering angle has no header.
    offset: float = 0.0
    stamped: bool = True


def messages(drive: Drive, types: Typestore, *, ros1: bool) -> list[tuple[str, str, int, Any]]:
    """Return topic, type, time of recording in ns and message, in the order of recording."""
    names = types.types
    vector, quaternion = names["geometry_msgs/msg/Vector3"], names["geometry_msgs/msg/Quaternion"]

    def header(t: float) -> Any:  # noqa: ANN401 - types made at run time
        ns = START + round(1e9 * (t + drive.offset)) if drive.stamped else 0
        stamp = names["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        sequence = {"seq": 0} if ros1 else {}
        return names["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **sequence)

    zero, covariance = vector(0.0, 0.0, 0.0), np.zeros(36)
    rows = []
    si = signals(drive.odom)
    for t, v_x, v_y in zip(drive.odom, si["v_x"], si["v_y"], strict=True):
        odometry = names["nav_msgs/msg/Odometry"](
            header(t),
            "base",
            names["geometry_msgs/msg/PoseWithCovariance"](
                names["geometry_msgs/msg/Pose"](
                    names["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), quaternion(0.0, 0.0, 0.0, 1.0)
                ),
                covariance,
            ),
            names["geometry_msgs/msg/TwistWithCovariance"](
                names["geometry_msgs/msg/Twist"](vector(v_x, v_y, 0.0), zero), covariance
            ),
        )
        rows.append(("/car/odom", "nav_msgs/msg/Odometry", t, odometry))
    si = signals(drive.imu)
    for t, omega, a_x in zip(drive.imu, si["omega"], si["a_x"], strict=True):
        nine = np.zeros(9)
        imu = names["sensor_msgs/msg/Imu"](
            header(t), quaternion(0.0, 0.0, 0.0, 1.0), nine,
            vector(0.0, 0.0, omega), nine, vector(a_x, 0.0, 9.8), nine,
        )  # fmt: skip
        rows.append(("/car/imu", "sensor_msgs/msg/Imu", t, imu))
    for t, delta in zip(drive.steer, signals(drive.steer)["delta"], strict=True):
        angles = np.array([0.0, np.rad2deg(delta)], dtype=np.float32)
        rows.append(("/car/steer", STEER, t, names[STEER](angles, "ok")))
    # Messages are recorded up to 2 ms late, and not in order.
    late = np.random.default_rng(0).uniform(0.0, 0.002, len(rows))
    timed = [
        (topic, kind, START + round(1e9 * (t + (0.0 if kind == STEER else delay))), message)
        for (topic, kind, t, message), delay in zip(rows, late, strict=True)
    ]
    return sorted(timed, key=lambda row: row[2])


def store(kind: Stores) -> Typestore:
    types = get_typestore(kind)
    types.register(get_types_from_msg("float32[] angles\nstring state\n", STEER))
    return types


def write_bag(path: Path, drive: Drive, plugin: StoragePlugin) -> None:
    types = store(Stores.ROS2_JAZZY)
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, time, message in messages(drive, types, ros1=False):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(connections[topic], time, types.serialize_cdr(message, kind))


def write_ros1(path: Path, drive: Drive) -> None:
    types = store(Stores.ROS1_NOETIC)
    with Ros1Writer(path) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, time, message in messages(drive, types, ros1=True):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(connections[topic], time, types.serialize_ros1(message, kind))


def write(folder: Path, form: str, drive: Drive | None = None) -> Path:
    """Write a drive as a bag of a form: folder, single file, or ROS 1."""
    drive = drive or Drive()
    if form == "ros1":
        write_ros1(folder / "drive.bag", drive)
        return folder / "drive.bag"
    plugin = StoragePlugin.MCAP if "mcap" in form else StoragePlugin.SQLITE3
    write_bag(folder / "drive", drive, plugin)
    if form.startswith("folder"):
        return folder / "drive"
    return next((folder / "drive").glob(f"*.{'mcap' if 'mcap' in form else 'db3'}"))


def load(path: Path, **changes: str) -> Dataset:
    columns = {name: Column.parse(text) for name, text in (COLUMNS | changes).items()}
    return import_log(path, columns, provenance(), mass=MASS)


@pytest.mark.parametrize("form", ["folder mcap", "folder sqlite", "mcap", "db3", "ros1"])
def test_bags_give_what_was_driven_at_the_times_of_the_headers(tmp_path: Path, form: str) -> None:
    data = load(write(tmp_path, form))
    # The first row is the first odometry after a message of the IMU, and each is a period later.
    assert len(data) == 599
    t = 0.01 + 0.05 * (200 * data.trajectory.astype(float) + data.step)
    truth = signals(t)
    np.testing.assert_allclose(data.z[:, 0], truth["v_x"], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(data.z[:, 1], truth["v_y"], rtol=0.0, atol=1e-12)
    # Interpolated between messages h = 10 and 20 ms apart: off by h² / 8 times the curvature.
    np.testing.assert_allclose(data.z[:, 2], truth["omega"], rtol=0.0, atol=2.5e-6)
    np.testing.assert_allclose(data.z[:, 3], truth["delta"], rtol=0.0, atol=3.3e-6)
    np.testing.assert_allclose(data.z[:, 4], MASS * signals(t + 0.02)["a_x"], rtol=0.0, atol=1.0)


def test_without_stamps_the_times_are_those_of_the_recording(tmp_path: Path) -> None:
    stamped = read_fields(write(tmp_path, "folder mcap"), ["/car/odom/twist.twist.linear.x"], 1)
    path = write(tmp_path / "other", "mcap", Drive(stamped=False))
    recorded = read_fields(path, ["/car/odom/twist.twist.linear.x"], 1)
    assert recorded.columns == ["time", "/car/odom/twist.twist.linear.x"]
    np.testing.assert_allclose(np.diff(stamped["time"]), 0.01, rtol=0.0, atol=1e-9)
    late = np.diff(recorded["time"]) - 0.01
    assert 0.0005 < np.std(late) < 0.002


def test_a_topic_that_pauses_breaks_the_log(tmp_path: Path) -> None:
    t = np.arange(1500) * 0.02
    data = load(write(tmp_path, "mcap", Drive(steer=t[(t < 5.0) | (t > 7.0)])))
    first, *others = consecutive(data)
    assert len(others) == 3
    assert len(first) == pytest.approx(5.0 / 0.05, abs=2)
    assert len(np.unique(data.trajectory)) == 3
    lost = (t[-1] - 0.05 * len(data)) - 2.0
    assert abs(lost) < 0.3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"v_x": "/car/wheel/x:m/s"}, r"no topic of '/car/wheel/x' .* /car/odom, /car/steer"),
        ({"v_x": "/car/odom/twist.linear.x:m/s"}, "has no 'linear', found twist, covariance"),
        ({"v_x": "/car/odom:m/s"}, "is no number: add one of its fields, header, child_frame_id"),
        ({"v_x": "/car/steer/state:m/s"}, "'/car/steer/state' is no number"),
        ({"delta": "/car/steer/angles[2]:deg"}, r"'/car/steer/angles\[2\]' has no '2'"),
        ({"time": "/car/odom/header.stamp.sec:s"}, "leave out --column time="),
        ({"v_x": "/car/odom/twist.twist.linear.x:km/h"}, "contradict each other"),
    ],
)
def test_columns_that_are_not_there_are_named(
    tmp_path: Path, changes: dict[str, str], message: str
) -> None:
    with pytest.raises(EgpError, match=message):
        load(write(tmp_path, "folder sqlite"), **changes)


def test_topics_without_column_are_listed_with_their_types(tmp_path: Path) -> None:
    columns = {"v_x": Column.parse(COLUMNS["v_x"])}
    with pytest.raises(EgpError, match=r"add --column v_y=TOPIC/FIELD:UNIT .*") as error:
        import_log(write(tmp_path, "mcap"), columns, provenance(), mass=MASS)
    assert "/car/imu (sensor_msgs/msg/Imu), /car/odom (nav_msgs/msg/Odometry), " in str(error.value)


def test_clocks_periods_and_empty_topics_are_checked(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with pytest.raises(EgpError, match=r"/car/odom \(1789996400.000 to .* different clocks"):
        load(write(tmp_path / "a", "mcap", Drive(offset=-3600.0)))
    (tmp_path / "b").mkdir()
    with pytest.raises(EgpError, match=r"/car/steer has a message every 0.1 s, .* --dt 0.1 or"):
        load(write(tmp_path / "b", "mcap", Drive(steer=np.arange(300) * 0.1)))
    (tmp_path / "c").mkdir()
    with pytest.raises(EgpError, match="/car/imu has 1 messages: expected at least two"):
        load(write(tmp_path / "c", "mcap", Drive(imu=np.array([1.0]))))


def test_files_that_are_no_complete_recording_are_named(tmp_path: Path) -> None:
    with (tmp_path / "empty.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(EgpError, match=r"empty\.mcap: the recording has no messages"):
        load(tmp_path / "empty.mcap")
    with (tmp_path / "announced.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        writer.register_channel("/step", "json", 0)
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(EgpError, match=r"announced\.mcap: .*/step"):
        read_fields(tmp_path / "announced.mcap")
    with pytest.raises(EgpError, match="no such file or folder"):
        load(tmp_path / "none.mcap")
    named = dict.fromkeys(("noise.mcap", "n.MCAP", "noise.db3", "noise.bag"), "not a readable rec")
    for name, told in (named | {"n.BAG": "bags are .* rename it to n.bag"}).items():
        (tmp_path / name).write_bytes(b"\x00\x01noise" * 300)
        with pytest.raises(EgpError, match=f"{name}: {told}"):
            load(tmp_path / name)
    (tmp_path / "folder").mkdir()
    with pytest.raises(EgpError, match="metadata"):
        load(tmp_path / "folder")
    whole = write(tmp_path, "db3")
    cut = tmp_path / "cut.db3"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    with pytest.raises(EgpError, match=r"cut\.db3: "):
        load(cut)


def test_an_interrupted_mcap_file_is_read_up_to_there(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=1000)
        writer.start()
        channel = writer.register_channel("/car", "json", 0)
        for k in range(500):
            writer.add_message(channel, 10**7 * k, b'{"speed": %d}' % k, 10**7 * k)
        writer.finish()  # type: ignore[no-untyped-call]
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    speeds = read_fields(path, ["/car/speed"], 0.02)["/car/speed"].to_list()
    assert 100 < len(speeds) < 300
    assert speeds == list(range(len(speeds)))
    assert "run.mcap was interrupted" in caplog.text
    path.write_bytes(whole[: len(whole) // 3] + bytes(range(200)) + whole[len(whole) // 3 :][:900])
    with pytest.raises(EgpError, match=r"run.mcap: the recording is damaged at byte \d+ "):
        read_fields(path, ["/car/speed"], 0.02)


@pytest.mark.parametrize("form", ["mcap", "db3", "ros1"])
def test_damaged_files_are_read_or_named(tmp_path: Path, form: str) -> None:
    t = np.arange(200) * 0.01
    path = write(tmp_path, form, Drive(odom=t, imu=t, steer=t[::2]))
    whole = path.read_bytes()
    rng = np.random.default_rng(5)
    named = 0
    for _ in range(25):
        damaged = bytearray(whole)
        for place in rng.integers(len(whole), size=4):
            damaged[place] = rng.integers(256)
        path.write_bytes(damaged[: rng.integers(len(whole) // 2, 2 * len(whole))])
        try:
            load(path)
        except EgpError:
            named += 1
    assert named > 0


def test_mcap_files_with_json(tmp_path: Path) -> None:
    path = tmp_path / "json.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("Car", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/car", "json", schema)
        for k in range(5):
            stamp = {"sec": 7, "nsec": 20_000_000 * k}
            data = json.dumps({"timestamp": stamp, "speed": [k, 2 * k]}).encode()
            writer.add_message(channel, 10**9 + k, data, 10**9 + k)
        writer.finish()  # type: ignore[no-untyped-call]
    path = path.rename(tmp_path / "JSON.MCAP")
    table = read_fields(path, ["/car/speed[1]"], 0.02)
    assert table["/car/speed[1]"].to_list() == [0.0, 2.0, 4.0, 6.0, 8.0]
    np.testing.assert_allclose(table["time"], 0.02 * np.arange(5))
    with pytest.raises(EgpError, match=r"has no 'velocity', found timestamp, speed"):
        read_fields(path, ["/car/velocity"], 0.02)


def test_parquet_files_with_times_of_the_clock(tmp_path: Path) -> None:
    t = np.arange(3000) * 0.01
    si = signals(t)
    start = pl.Series("t", np.datetime64(START, "ns") + np.round(1e9 * t).astype("timedelta64[ns]"))
    pl.DataFrame({"t": start} | si).write_parquet(tmp_path / "drive.parquet")
    units = {"v_x": "m/s", "v_y": "m/s", "omega": "rad/s", "delta": "rad", "a_x": "m/s2"}
    columns = {q: Column(q, unit) for q, unit in units.items()} | {"time": Column("t", "s")}
    data = import_log(tmp_path / "drive.parquet", columns, provenance(), mass=MASS)
    assert len(data) == 599
    np.testing.assert_allclose(data.z[:200, 0], si["v_x"][:1000:5], rtol=0.0, atol=1e-12)
    pl.DataFrame(
        {"t": start, "v_x": [[1.0]] * 3000} | {q: si[q] for q in si if q != "v_x"}
    ).write_parquet(tmp_path / "nested.parquet")
    with pytest.raises(EgpError, match="column 'v_x' holds List"):
        import_log(tmp_path / "nested.parquet", columns, provenance(), mass=MASS)
    (tmp_path / "noise.parquet").write_bytes(b"noise")
    with pytest.raises(EgpError, match="not a readable Parquet file"):
        import_log(tmp_path / "noise.parquet", columns, provenance(), mass=MASS)


def test_the_command_imports_bags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = write(tmp_path, "folder mcap")
    arguments = ["collect", "--friction", "0.8", "--dt", "0.05", "--mass", str(MASS)]
    for quantity, column in COLUMNS.items():
        arguments += ["--column", f"{quantity}={column}"]
    output = tmp_path / "data.parquet"
    result = CliRunner().invoke(app, [*arguments, "--from-log", str(bag), "-o", str(output)])
    assert result.exit_code == 0, result.output
    data = Dataset.read(output)
    assert data.provenance.method == "log drive"
    assert f"{len(data)} transitions" in " ".join(result.output.split())
    # The same from within the bag's folder, and from one that is no bag.
    monkeypatch.chdir(bag)
    result = CliRunner().invoke(app, [*arguments, "--from-log", ".", "-o", str(output)])
    assert result.exit_code == 0, result.output
    assert Dataset.read(output).provenance.method == "log drive"
    monkeypatch.chdir(tmp_path)
    for more in ([], ["--column", "time=t:s"]):
        command = [*arguments, *more, "--from-log", ".", "-o", str(output)]
        told = str(CliRunner().invoke(app, command).exception)
        assert told.startswith(".: this folder is no bag of ROS 2")
    command = [*arguments, "--column", "time=t:s", "--from-log", str(bag), "-o", str(output)]
    told = str(CliRunner().invoke(app, command).exception)
    assert told.startswith(f"{bag}: the recording states the time of its messages: leave out --col")
