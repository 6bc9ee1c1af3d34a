"""`egp view`: the file of Rerun holds what the recording holds, and the viewer shows it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rerun_cli
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient
from typer.testing import CliRunner

from egp_service import Controller, EgpError, Plant, Recorder, shipped
from egp_service.cli import app
from egp_service.control.endpoints import free_port
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.runs import record_run
from egp_service.simulation.scenario import parse_scenario
from egp_service.view.viewer import QUIET
from patience import PATIENCE

if TYPE_CHECKING:
    from numpy.typing import NDArray

ROOMS = Path(shipped.__file__).parents[1]
MEMBERS = ["mu 0.5", "mu 1.1"]
# Entity, topic and field of every curve.
CURVES = {
    "/lateral/error": ("/plant", "lateral_error"),
    "/speed/measured": ("/step", "v_x"),
    "/speed/reference": ("/plant", "speed_reference"),
    "/friction/true": ("/plant", "friction"),
    "/friction/planned": ("/plant", "friction_planned"),
    "/friction/lower": ("/step", "friction_lower"),
    "/friction/upper": ("/step", "friction_upper"),
    "/force/command": ("/step", "force"),
    "/steering/angle": ("/step", "delta"),
    "/steering/rate": ("/step", "steering_rate"),
    "/times/total": ("/step", "total_ms"),
    "/times/queue": ("/step", "queue_ms"),
    "/times/compute": ("/step", "compute_ms"),
}

GREY, ORANGE, BLUE, GREEN = (156, 163, 175), (232, 106, 43), (75, 163, 199), (106, 153, 78)
# The colours of true, planned and found friction; of trajectory and plan on the light ground.
DRAWN = {"Friction": [GREY, ORANGE, BLUE, GREEN], "Map": [ORANGE, BLUE, (244, 245, 247)]}

Columns = dict[str, list[Any]]


def view(*arguments: str | Path, **environment: str) -> str:
    result = CliRunner().invoke(app, ["view", *map(str, arguments)], env=environment)
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result.output


def failure(*arguments: str | Path) -> str:
    result = CliRunner().invoke(app, ["view", *map(str, arguments)])
    assert isinstance(result.exception, EgpError), result.output
    return str(result.exception)


def entities(path: Path) -> dict[str, Columns]:
    """Read a file with Rerun's own reader: the columns of each entity, static ones included."""
    found: dict[str, Columns] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        columns = found.setdefault(str(chunk.entity_path), {})
        for name in batch.schema.names:
            columns.setdefault(name, []).extend(batch.column(name).to_pylist())
    return found


def seconds(columns: Columns) -> list[float]:
    return [time.total_seconds() for time in columns["time"]]


def topics(path: Path) -> dict[str, list[Any]]:
    """Read a recording with MCAP's own reader: time in s and message by topic."""
    found: dict[str, list[Any]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, record, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((record.log_time * 1e-9, message))
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drive a short part of a lap and return its recording."""
    text = (ROOMS / "simulation/scenarios/rounded-rectangle.toml").read_text()
    scenario = parse_scenario(f"laps = 0.05\n{text}", Path("/"), "short")
    folder = tmp_path_factory.mktemp("short")
    with in_process_controller(scenario) as controller:
        record_run(scenario, controller, folder, lambda _: None)
    return folder / "run.mcap"


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a controller alone, which stops while the measured yaw is not a number."""
    path = tmp_path_factory.mktemp("own") / "own.mcap"
    limits = Plant().parameters.gate_limits()
    with Controller(str(shipped.DEMO_LIBRARY), gate=limits) as controller:
        s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
        with Recorder(path, controller) as recorder:
            for k in range(60):
                ahead = 15.0 * controller.dt * k
                x = np.array([ahead, 0.1, 15.0, np.nan if 20 <= k < 30 else 0.0, 0.0, 0.0, 0.0])
                reference = np.column_stack([s + ahead, 0 * s, 0 * s + 15.0, 0 * s])
                recorder.add(controller.step(x, reference), x, controller.dt * k)
    return path


def test_curves_have_the_values_of_the_recording(run: Path, tmp_path: Path) -> None:
    target = tmp_path / "deep/run.rrd"
    printed = view(run, "--save", target)
    assert list(target.parent.iterdir()) == [target]
    saved, recorded = entities(target), topics(run)
    times = [time for time, _ in recorded["/step"]]
    assert f"{len(times)} control steps in {times[-1] - times[0]:.1f} s" in printed
    assert len(times) > 80
    for entity, (topic, field) in CURVES.items():
        assert seconds(saved[entity]) == pytest.approx([time for time, _ in recorded[topic]])
        values = [[getattr(message, field)] for _, message in recorded[topic]]
        np.testing.assert_array_equal(saved[entity]["Scalars:scalars"], values)
    for i, member in enumerate(MEMBERS):
        columns = saved["/weights/" + member.replace(" ", r"\ ")]
        assert columns["SeriesLines:names"] == [[member]]
        weights = [[step.weights[i]] for _, step in recorded["/step"]]
        assert columns["Scalars:scalars"] == weights
    assert saved["/state/mode"]["StateChange:state"] == [["normal"]]
    assert saved["/changes"]["TextLog:text"] == [["normal, solved"]]
    assert json.loads(saved["/__properties/recorded"]["members"][0][0]) == MEMBERS


def test_the_map_has_road_car_and_plans_of_the_recording(run: Path, tmp_path: Path) -> None:
    shown = view(run, "--save", tmp_path / "run.rrd", FORCE_COLOR="1")
    assert shown.index("Reading ...") < shown.index("Writing ...") < shown.index("Saved")
    saved, recorded = entities(tmp_path / "run.rrd"), topics(run)
    ((_, scene),) = recorded["/scene"]
    road, car = scene.entities
    surface = saved["/map/road/surface/0"]
    corners = [(point.x, point.y, point.z) for point in road.triangles[0].points]
    np.testing.assert_allclose(surface["Mesh3D:vertex_positions"][0], corners, rtol=1e-6)
    assert np.ravel(surface["Mesh3D:triangle_indices"]).tolist() == list(road.triangles[0].indices)
    # Each colour is four bytes, red first.
    reds = np.array(surface["Mesh3D:vertex_colors"][0]) >> 24
    np.testing.assert_allclose(reds / 255, [c.r for c in road.triangles[0].colors], atol=1 / 255)
    assert saved["/map/road/label"]["Points3D:labels"] == [[text.text for text in road.texts]]
    size = car.cubes[0].size
    halves = saved["/map/car/car/body"]["Boxes3D:half_sizes"][0][0]
    assert 2.0 * np.array(halves) == pytest.approx([size.x, size.y, size.z])
    poses = [message.pose for _, message in recorded["/pose"]]
    moving = saved["/map/car"]
    places = np.array([[pose.position.x, pose.position.y] for pose in poses])
    np.testing.assert_allclose(first(moving, "translation")[:, :2], places, atol=1e-4)
    turns = [[pose.orientation.z, pose.orientation.w] for pose in poses]
    np.testing.assert_allclose(first(moving, "quaternion")[:, 2:], turns, atol=1e-6)
    line = np.array(saved["/map/trajectory"]["LineStrips3D:strips"][0][0])
    np.testing.assert_allclose(line[:, :2], places, atol=1e-4)
    plan = saved["/map/plan"]
    assert seconds(plan) == pytest.approx([time for time, _ in recorded["/plan"]])
    for (strip,), (_, message) in zip(strips(plan), recorded["/plan"], strict=True):
        planned = [[pose.position.x, pose.position.y] for pose in message.poses]
        np.testing.assert_allclose(np.array(strip)[:, :2], planned, atol=1e-4)


def first(columns: Columns, name: str) -> NDArray[np.float64]:
    return np.array([row[0] for row in columns[f"Transform3D:{name}"]])


def strips(columns: Columns) -> list[list[list[list[float]]]]:
    return [row for row in columns["LineStrips3D:strips"] if row is not None]


def test_a_recording_without_plant_shows_what_it_has(own: Path, tmp_path: Path) -> None:
    view(own, "--save", tmp_path / "own.rrd")
    saved = entities(tmp_path / "own.rrd")
    shown = {entity for entity, (topic, _) in CURVES.items() if topic == "/step"}
    assert shown == CURVES.keys() & saved.keys()
    lower = np.ravel(saved["/friction/lower"]["Scalars:scalars"])
    assert (np.flatnonzero(np.isnan(lower)) == np.arange(20, 30)).all()
    assert len(saved["/map/car"]["time"]) == 50
    assert "/map/car/arrow" in saved
    # While it stops, no plan is shown.
    assert [len(row) for row in strips(saved["/map/plan"])] == [1] * 20 + [0] * 10 + [1] * 30
    mode = saved["/state/mode"]
    assert list(zip(seconds(mode), mode["StateChange:state"], strict=True)) == [
        (0.0, ["normal"]),
        (0.4, ["stop"]),
    ]
    texts = [text for (text,) in saved["/changes"]["TextLog:text"]]
    assert texts[1].startswith("stop, invalid_state: ")
    assert "psi" in texts[1]


def test_entities_of_other_frames_are_left_out(tmp_path: Path) -> None:
    entities_of = [SceneEntity(frame_id=frame, id=frame) for frame in ("map", "odom")]
    for entity in entities_of:
        entity.texts.add(text="here")
    with Controller(shipped.DEMO_LIBRARY, gate=Plant().parameters.gate_limits()) as controller:
        s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
        x = np.array([0.0, 0.1, 15.0, 0.0, 0.0, 0.0, 0.0])
        step = controller.step(x, np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s]))
        with Recorder(tmp_path / "own.mcap", controller) as recorder:
            recorder.message("/scene", SceneUpdate(entities=entities_of), 0.0)
            recorder.add(step, x, 0.0)
    view(tmp_path / "own.mcap", "--save", tmp_path / "own.rrd")
    shown = [name for name in entities(tmp_path / "own.rrd") if name.endswith("/label")]
    assert shown == ["/map/map/label"]


def test_an_interrupted_recording_is_shown_up_to_there(run: Path, tmp_path: Path) -> None:
    whole = run.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: 3 * len(whole) // 4])
    told = view(cut, "--save", tmp_path / "cut.rrd")
    assert "its last steps are missing" in told
    count = int(re.findall(r"(\d+) control steps", told)[0])
    saved, recorded = entities(tmp_path / "cut.rrd"), topics(run)
    measured = saved["/speed/measured"]["Scalars:scalars"]
    assert 0 < count == len(measured) < len(recorded["/step"])
    assert measured == [[step.v_x] for _, step in recorded["/step"][:count]]


def test_a_full_disk_is_an_error_that_leaves_nothing(run: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "egp_service", "view", run, "--save", tmp_path / "run.rrd"]
    done = subprocess.run(
        ["/bin/bash", "-c", 'ulimit -f 20; exec "$@"', "bash", *map(str, command)],
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    assert done.returncode == 1
    assert "Saved" not in done.stdout
    assert f"{tmp_path / 'run.rrd'}: File too large" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_folder_of_a_drive_stands_for_its_recording(run: Path, tmp_path: Path) -> None:
    printed = view(run.parent, "--save", tmp_path / "run.rrd")
    assert f"{run}: " in printed
    assert f"the folder {tmp_path}, in which there is no run.mcap" in failure(tmp_path)


def test_other_files_and_names_are_errors(run: Path, tmp_path: Path) -> None:
    target = tmp_path / "run.rrd"
    assert "ends in .rrd" in failure(run, "--save", tmp_path / "run.bin")
    assert f"such as {tmp_path / 'run.rrd'}" in failure(run, "--save", tmp_path)
    head = tmp_path / "head.mcap"
    head.write_bytes(run.read_bytes()[:3000])
    assert "found 0 steps" in failure(head, "--save", target)
    (tmp_path / "text.mcap").write_text("text")
    assert "expected an MCAP recording" in failure(tmp_path / "text.mcap", "--save", target)
    assert not target.exists()


@pytest.mark.parametrize(
    ("schema", "encoding", "data", "message"),
    [
        ("", "protobuf", b"", "expected foxglove.PosesInFrame .* on /plan, found no type"),
        ("nav.Path", "protobuf", b"", "on /plan, found nav.Path as 'protobuf'"),
        ("foxglove.PosesInFrame", "json", b"{}", "found foxglove.PosesInFrame as 'json'"),
        ("foxglove.PosesInFrame", "protobuf", b"\xff\xff", "the recording is damaged"),
        ("foxglove.PosesInFrame", "protobuf", b"", "found 0 steps and no metadata 'egp.about'"),
    ],
)
def test_topics_of_other_programs_are_named(
    tmp_path: Path, schema: str, encoding: str, data: bytes, message: str
) -> None:
    file = tmp_path / "other.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        number = writer.register_schema(schema, "protobuf", b"") if schema else 0
        channel = writer.register_channel("/plan", encoding, number)
        writer.add_message(channel, 0, data, 0)
        writer.finish()  # type: ignore[no-untyped-call]
    assert re.search(message, failure(file, "--save", tmp_path / "run.rrd"))


@pytest.mark.parametrize("members", [None, "mu", "5", "[1, 2]"])
def test_members_that_cannot_be_read_are_named(tmp_path: Path, members: str | None) -> None:
    file = tmp_path / "own.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        about = {"dt": "x"} if members is None else {"members": members}
        writer.add_metadata("egp.about", about)
        schema = writer.register_schema("egp.v1.StepRecord", "protobuf", b"")
        channel = writer.register_channel("/step", "protobuf", schema)
        writer.add_message(channel, 0, b"", 0)
        writer.finish()  # type: ignore[no-untyped-call]
    told = failure(file, "--save", tmp_path / "run.rrd")
    found = "missing" if members is None else repr(members)
    assert told.startswith(f"{file}: metadata 'egp.about': members is {found}: expected the names")


def test_without_a_display_the_error_names_the_option_and_nothing_is_reported_home(
    run: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET", "CI", "FORCE_RERUN_ANALYTICS"):
        monkeypatch.delenv(name, raising=False)
    message = failure(run)
    assert message.startswith("there is no display")
    assert "--save FILE.rrd" in message
    assert not capfd.readouterr().err
    # The viewer starts if a display is named, which does not exist here.
    monkeypatch.setenv("DISPLAY", ":987")
    monkeypatch.setenv("RUST_LOG", "debug")
    assert "--save FILE.rrd" in failure(run)
    assert "Analytics disabled" in capfd.readouterr().err


def test_the_viewer_draws_map_and_curves(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not any(Path("/usr/share/vulkan/icd.d").glob("*.json")):
        pytest.skip("no driver of Vulkan, for instance Debian's mesa-vulkan-drivers")
    target = tmp_path / "run.rrd"
    view(run, "--save", target)
    for name, value in QUIET.items():
        monkeypatch.setenv(name, value)
    program = str(Path(rerun_cli.__file__).with_name("rerun"))
    with ViewerClient.spawn(headless=True, port=free_port(), executable_path=program) as viewer:
        viewer.open(str(target))
        views = {view.name: view for view in viewer.get_state().views}
        assert len(views) == 11
        assert not [view for view in views.values() if view.reports or not view.visible]
        for name, colours in DRAWN.items():
            deadline = time.monotonic() + 20.0
            while min(pixels(viewer.take_screenshot(views[name].view_id), colours)) < 60:
                assert time.monotonic() < deadline, name


def pixels(picture: bytes, colours: list[tuple[int, int, int]]) -> list[int]:
    """Count the pixels of each colour, of which a legend has about 20."""
    image = np.asarray(Image.open(BytesIO(picture)).convert("RGB"), dtype=np.int64)
    return [int((np.abs(image - colour).max(axis=2) < 12).sum()) for colour in colours]


def test_a_recording_that_begins_without_replies_is_shown(tmp_path: Path) -> None:
    with Controller(shipped.DEMO_LIBRARY, gate=Plant().parameters.gate_limits()) as controller:
        s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
        reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
        with Recorder(tmp_path / "run.mcap", controller) as recorder:
            for number in range(5):
                x = np.array([0.0, 0.2, 15.0, 0.0, 0.0, 0.0, 0.0]) + (np.nan if number < 2 else 0.0)
                recorder.add(controller.step(x, reference), x, number * controller.dt)
    view(tmp_path / "run.mcap", "--save", tmp_path / "run.rrd")
    assert (tmp_path / "run.rrd").stat().st_size > 0
