"""One lap over three surfaces in this process: driven well, recorded, replayed bit for bit."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest.mock import Mock
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from matplotlib import pyplot as plt
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from typer.testing import CliRunner

from egp_service import Controller, EgpError, Library
from egp_service._core import write_library_subset
from egp_service.cli import app
from egp_service.cli.replay_text import outcome
from egp_service.control.recorded import RecordingError, read_recording
from egp_service.control.replay import Answer, Replay, replay
from egp_service.simulation.report import (
    _step_times_figure,
    _weights_figure,
    draw_comparison,
    draw_run,
)
from egp_service.simulation.runs import record_run
from egp_service.simulation.scenario import (
    gate_settings,
    library_path,
    load_scenario,
    parse_scenario,
    told_zones,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from egp_service.simulation.closed_loop import Run
    from egp_service.simulation.trace import Period

SCENARIO = told_zones(load_scenario("rounded-rectangle"))


class Lap(NamedTuple):
    """The lap that all tests of this file use."""

    run: Run
    folder: Path
    periods: list[Period]


@pytest.fixture(scope="module")
def lap(tmp_path_factory: pytest.TempPathFactory) -> Lap:
    folder = tmp_path_factory.mktemp("lap")
    periods: list[Period] = []
    with Controller(library_path(SCENARIO), gate=gate_settings(SCENARIO)) as controller:
        run = record_run(SCENARIO, controller, folder, periods.append)
    return Lap(run, folder, periods)


def messages(folder: Path, topic: str) -> Iterator[bytes]:
    with (folder / "run.mcap").open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=[topic]):
            yield message.data


def test_the_ensemble_completes_the_lap_within_a_metre(lap: Lap) -> None:
    summary = lap.run.summary
    assert summary.ending.completed, summary.ending.reason
    assert summary.lateral_error.max < 1.0
    assert summary.stop_ticks == 0
    assert set(summary.solver_statuses) <= {"solved", "late"}


def test_the_weights_follow_the_surfaces_in_the_corners(lap: Lap) -> None:
    trace = lap.run.trace
    cornering = np.abs(trace.x[:, 2] * trace.x[:, 5]) > 0.4 * 9.81 * trace.friction
    believed = trace.weights @ lap.run.frictions
    wet = np.mean(believed[cornering & (trace.friction == 0.5)])
    dry = np.mean(believed[cornering & (trace.friction == 1.1)])
    assert wet < 0.75
    assert dry > 0.95


def test_the_friction_is_informed_where_the_car_uses_the_grip(lap: Lap) -> None:
    found = [period.step.friction for period in lap.periods]
    told = [friction for friction in found if friction is not None and friction.informed]
    untold = [friction for friction in found if friction is not None and not friction.informed]
    assert min(friction.information for friction in told) >= 0.1
    assert max(friction.information for friction in untold) < 0.1
    # Without information the 90 % interval is that of the prior, 1.08 wide.
    assert min(friction.upper - friction.lower for friction in untold) > 0.8
    assert np.median([friction.upper - friction.lower for friction in told]) < 0.6


def test_a_controller_states_the_frictions_of_its_members() -> None:
    file = library_path(SCENARIO)
    with Controller(file, gate=gate_settings(SCENARIO)) as controller:
        assert controller.frictions == [member.friction for member in Library.load(file).members]


def test_the_summary_is_on_disk_as_json(lap: Lap) -> None:
    summary = json.loads((lap.folder / "summary.json").read_text())
    assert summary["ending"]["completed"] is True
    assert summary["lateral_error"]["max"] == lap.run.summary.lateral_error.max
    assert set(summary["step_time_ms"]) == {"p50", "p90", "p99", "max"}


def test_the_resolved_scenario_drives_the_same_run_again(lap: Lap) -> None:
    text = (lap.folder / "scenario.toml").read_text()
    assert tomllib.loads(text)["name"] == SCENARIO.name
    assert parse_scenario(text, Path("/"), "resolved") == SCENARIO


def test_the_recording_holds_the_bytes_that_were_exchanged(lap: Lap) -> None:
    assert list(messages(lap.folder, "/request")) == [p.step.request for p in lap.periods]
    assert list(messages(lap.folder, "/reply")) == [p.step.reply for p in lap.periods]


def test_any_protobuf_reader_can_decode_the_recording(lap: Lap) -> None:
    with (lap.folder / "run.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded = [
            (channel.topic, message)
            for _, channel, _, message in reader.iter_decoded_messages(topics=["/plant", "/reply"])
        ]
    truths = [message for topic, message in decoded if topic == "/plant"]
    replies = [message for topic, message in decoded if topic == "/reply"]
    assert [truth.v_x for truth in truths] == lap.run.trace.x[:, 2].tolist()
    assert [truth.friction for truth in truths] == lap.run.trace.friction.tolist()
    assert list(replies[-1].plan_u.shape) == [40, 2]


def test_other_tools_find_their_own_schemas_and_plain_numbers(lap: Lap) -> None:
    topics: dict[str, tuple[str, list[Any]]] = {}
    with (lap.folder / "run.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, _, message in reader.iter_decoded_messages():
            assert schema is not None
            topics.setdefault(channel.topic, (schema.name, []))[1].append(message)
    assert {topic: name for topic, (name, _) in topics.items() if "foxglove" in name} == {
        "/pose": "foxglove.PoseInFrame",
        "/tf": "foxglove.FrameTransform",
        "/plan": "foxglove.PosesInFrame",
        "/scene": "foxglove.SceneUpdate",
    }
    steps, poses = topics["/step"][1], topics["/pose"][1]
    assert [step.total_ms for step in steps] == (1e3 * lap.run.trace.step_time).tolist()
    assert [pose.pose.position.x for pose in poses] == [p.measured[0] for p in lap.periods]
    assert len(topics["/plan"][1][0].poses) == 41
    (scene,) = topics["/scene"][1]
    assert [text.text for text in scene.entities[0].texts] == [
        "friction 0.5",
        "friction 1.1",
        "friction 0.8",
    ]
    # The layout that is written beside the recording shows only topics that it has.
    layout = (lap.folder / "foxglove.json").read_text()
    assert {f"/{name}" for name in re.findall(r'"/(\w+)', layout)} <= set(topics)


def test_the_layout_of_plotjuggler_has_the_curves_of_foxglove(lap: Lap) -> None:
    with (lap.folder / "run.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded = reader.iter_decoded_messages(topics=["/step", "/plant"])
        recorded = {name for row in decoded for name in plotjuggler_names(row[1].topic, row[3])}
    layout = ET.parse(lap.folder / "plotjuggler.xml").getroot()  # noqa: S314 - ours
    curves = {curve.attrib["name"] for curve in layout.iter("curve")}
    assert curves <= recorded
    assert {"/step/weights[0]", "/step/weights[1]"} <= curves
    plots = re.findall(
        r'"value": "(/\w+)\.([\w\[\]]+)"', (lap.folder / "foxglove.json").read_text()
    )
    assert curves == {f"{topic}/{field}" for topic, field in plots} & recorded
    file = layout.find("previouslyLoaded_Datafiles/fileInfo")
    assert file is not None
    assert file.attrib["filename"] == "run.mcap"
    for splitter in layout.iter("DockSplitter"):
        sizes = splitter.attrib["sizes"].split(";")
        assert len(splitter) == len(sizes) == int(splitter.attrib["count"])


def plotjuggler_names(topic: str, message: Any) -> Iterator[str]:  # noqa: ANN401 - of any schema
    """Give the numeric fields as PlotJuggler's parser of protobuf names them."""
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.is_repeated:
            yield from (f"{topic}/{field.name}[{i}]" for i in range(len(value)))
        elif isinstance(value, float | bool):
            yield f"{topic}/{field.name}"


def test_a_replay_gives_the_recorded_bytes(lap: Lap) -> None:
    result = CliRunner().invoke(app, ["replay", str(lap.folder / "run.mcap")])
    assert result.exit_code == 0, result.output
    assert f"All {len(lap.periods)} replies have the same bytes" in result.output


def test_a_replay_without_a_difference_draws_nothing_and_says_so(
    first_tenth: Path, tmp_path: Path
) -> None:
    picture = tmp_path / "pictures" / "differences.png"
    command = ["replay", str(first_tenth), "-o", str(picture)]
    result = CliRunner().invoke(app, command, env={"FORCE_COLOR": "1"})
    assert result.exit_code == 0, result.output
    assert "No picture: nothing differs." in result.output
    assert not picture.parent.exists()
    assert "replaying" in result.output  # as a terminal shows it


def test_a_picture_that_cannot_be_drawn_is_an_error_before_the_replay(
    first_tenth: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, settings = tmp_path / "run.mcap", tmp_path / "softer.toml"
    recording.write_bytes(first_tenth.read_bytes())
    settings.write_text("cost.lateral = 20.0", encoding="utf-8")
    (tmp_path / "run-replay-softer.png").mkdir()
    replayed = Mock()
    monkeypatch.setattr("egp_service.control.replay.replay", replayed)
    result = CliRunner().invoke(app, ["replay", str(recording), "--settings", str(settings)])
    assert "run-replay-softer.png is a folder" in str(result.exception)
    replayed.assert_not_called()


@pytest.fixture(scope="module")
def first_tenth(lap: Lap) -> Path:
    whole = (lap.folder / "run.mcap").read_bytes()
    path = lap.folder / "cut.mcap"
    path.write_bytes(whole[: len(whole) // 10])
    return path


def test_an_interrupted_recording_can_be_replayed(
    lap: Lap, first_tenth: Path, tmp_path: Path
) -> None:
    whole = (lap.folder / "run.mcap").read_bytes()
    recorded = read_recording(first_tenth)
    assert not recorded.complete
    assert recorded.scenario == SCENARIO.toml()
    assert len(recorded.steps) > 0.05 * len(lap.periods)
    again = replay(recorded, library_path(SCENARIO), recorded.settings or {})
    assert again.same.all()
    damaged = bytearray(whole)
    middle = len(whole) // 2
    damaged[middle : middle + 200] = bytes(200)
    (tmp_path / "[").mkdir()
    path = tmp_path / "[" / "x].mcap"
    path.write_bytes(damaged)
    told = CliRunner().invoke(app, ["replay", str(path)]).output
    at, behind = map(int, re.findall(r"damaged at byte (\d+) .*; the (\d+) bytes", told)[0])
    assert at < middle < at + behind == len(whole)
    assert told.startswith(f"{path}: ")
    path.write_bytes(b"no recording")
    with pytest.raises(RecordingError, match="expected an MCAP recording"):
        read_recording(path)


def test_a_replay_shows_where_other_settings_matter(lap: Lap, tmp_path: Path) -> None:
    settings, picture = tmp_path / "softer.toml", tmp_path / "differences.png"
    settings.write_text("cost.lateral = 20.0\n")
    wrong = ["replay", "absent.mcap", "-o"]
    for output, expected in ((tmp_path, "is a folder"), (tmp_path / "a.xyz", "use .png")):
        with pytest.raises(EgpError, match=expected):
            CliRunner().invoke(app, [*wrong, str(output)], catch_exceptions=False)
    command = ["replay", str(lap.folder / "run.mcap"), "--settings", str(settings)]
    result = CliRunner().invoke(app, [*command, "--output", str(picture)])
    assert result.exit_code == 0, result.output
    assert "cost.lateral: 80.0 → 20.0" in result.output
    assert picture.stat().st_size > 10_000
    recorded = read_recording(lap.folder / "run.mcap")
    again = replay(recorded, library_path(SCENARIO), {"cost": {"lateral": 20.0}})
    first = again.first_that_matters
    assert first is not None
    assert f"step {first + 1} at {again.time[first]:.2f} s" in result.output
    assert (again.share[:first] <= 0.01).all()
    assert f"{again.u_now[first, 1]:+.4f} rad/s" in result.output
    settings.write_text("[cost]\nlaterall = 20.0\n")
    refused = CliRunner().invoke(app, command)
    assert re.search(r"softer\.toml: .*line 2.*laterall", str(refused.exception), re.DOTALL)


def test_a_replay_with_another_prior_solver_and_window(first_tenth: Path, tmp_path: Path) -> None:
    settings = tmp_path / "other.toml"
    command = ["replay", str(first_tenth), "--settings", str(settings), "--no-pictures"]
    for text, shown in (
        ("weights.prior = { kind = 'l1', alpha = 1e-5 }", "weights.prior.kind: quadratic → l1"),
        ("solver.kind = 'clarabel'", "solver.kind: riccati → clarabel"),
        ("weights.window = 10", "weights.window: 25 → 10"),
    ):
        settings.write_text(text)
        result = CliRunner().invoke(app, command)
        assert result.exit_code == 0, result.exception
        assert shown in result.output
    recorded = read_recording(first_tenth)
    again = replay(recorded, library_path(SCENARIO), {"weights": {"window": 10}})
    assert len(again.now) > 50
    assert {answer.status for answer in again.now} == {"solved"}
    # In the first periods no request has more than ten transitions.
    assert again.same[:10].all()
    assert not again.same[11:50].any()
    with pytest.raises(RecordingError, match=r"weights\.window = 25"):
        replay(recorded, library_path(SCENARIO), {"weights": {"window": 26}})


def test_a_replay_with_another_library(lap: Lap, tmp_path: Path) -> None:
    library = tmp_path / "one.safetensors"
    write_library_subset(library_path(SCENARIO), library, [1])
    recorded = read_recording(lap.folder / "run.mcap")
    again = replay(recorded, library, {})
    assert {answer.status for answer in again.now} == {"solved"}
    assert {answer.weights.tolist()[0] for answer in again.now} == {1.0}
    assert again.first_that_matters is not None
    with pytest.raises(RecordingError, match="horizon = 40"):
        replay(recorded, library, {"horizon": 30})


def test_the_largest_difference_is_one_of_two_plans(lap: Lap) -> None:
    def steps(*forces: float) -> list[Answer]:
        return [Answer("solved", np.array([each, 0.0]), np.ones(1)) for each in forces]

    def told(*forces: float) -> list[str]:
        recorded, n = read_recording(lap.folder / "run.mcap"), len(forces)
        same = np.array(forces) == 0.0
        time, x, ranges = np.arange(n) / 50.0, np.zeros((n, 7)), np.full(2, 100.0)
        again = Replay(time, x, steps(*n * [0.0]), steps(*forces), same, ranges, 0)
        return outcome(recorded, again, {}, changed=True)[-2:]

    lone, largest = told(0.0, np.nan, 20.0, 30.0)
    assert lone == "In 1 steps only one of the two has a plan."
    assert largest.startswith("Largest difference: step 4 ")
    first, lone = told(0.0, 0.0, np.nan)
    assert "(in 1 steps): step 3 " in first
    assert lone == "In 1 steps only one of the two has a plan."


def test_the_times_of_steps_are_drawn_with_their_deadline(lap: Lap) -> None:
    figure = _step_times_figure(lap.run)
    texts = [text.get_text() for text in figure.axes[0].texts]
    plt.close(figure)
    assert texts[-1] == "deadline 16 ms"
    assert lap.run.dt == 0.02


def test_pictures_are_drawn(lap: Lap, tmp_path: Path) -> None:
    pictures = [*draw_run(lap.run, tmp_path), draw_comparison([("a", lap.run)], tmp_path / "c.png")]
    for picture in pictures:
        assert picture.read_bytes().startswith(b"\x89PNG")
        assert picture.stat().st_size > 10_000


def test_each_change_of_a_replay_has_its_own_picture(lap: Lap, tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    recording.write_bytes((lap.folder / "run.mcap").read_bytes())
    command = ["replay", str(recording), "--settings"]
    for name, lateral in (("soft", 20.0), ("softer", 5.0)):
        settings = tmp_path / f"{name}.toml"
        settings.write_text(f"cost.lateral = {lateral}\n")
        result = CliRunner().invoke(app, [*command, str(settings)], env={"FORCE_COLOR": "1"})
        assert result.exit_code == 0, result.output
        assert "Drawing ..." in result.output  # as a terminal shows it
    drawn = sorted(path.name for path in tmp_path.glob("*.png"))
    assert drawn == ["run-replay-soft.png", "run-replay-softer.png"]
    # Nor does a replay replace a picture of the run itself.
    own = [*command, str(settings), "-o", str(tmp_path / "track.png")]
    with pytest.raises(EgpError, match=r"track\.png is a picture of the recorded run"):
        CliRunner().invoke(app, own, catch_exceptions=False)
    assert not (tmp_path / "track.png").exists()


def test_the_picture_of_weights_shows_all_of_its_curves(lap: Lap) -> None:
    limits = []
    for factor in (1.0, 2.5):
        trace = replace(lap.run.trace, friction=factor * lap.run.trace.friction)
        slow = replace(trace, x=trace.x * np.where(np.arange(7) == 5, 3.0 * factor, 1.0))
        figure = _weights_figure(replace(lap.run, trace=slow))
        _, middle, bottom = figure.axes
        limits.append((middle.get_ylim()[1], bottom.get_ylim()[1]))
        assert middle.get_ylim()[1] > trace.friction.max()
        grip = np.abs(slow.x[:, 3 - 1] * slow.x[:, 5]) / (9.81 * slow.friction)
        assert bottom.get_ylim()[1] > grip.max()
        plt.close(figure)
    assert limits[0][0] == 1.4
