"""One lap over three surfaces in this process: driven well, recorded, replayed bit for bit."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from egp_service import Controller
from egp_service._core import Engine
from egp_service.simulation.report import draw_comparison, draw_run
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


def test_replaying_the_recorded_requests_gives_the_recorded_replies(lap: Lap) -> None:
    engine = Engine(str(library_path(SCENARIO)))
    replies = messages(lap.folder, "/reply")
    for request, reply in zip(messages(lap.folder, "/request"), replies, strict=True):
        assert engine.step(request) == reply


def test_pictures_are_drawn(lap: Lap, tmp_path: Path) -> None:
    pictures = [*draw_run(lap.run, tmp_path), draw_comparison([("a", lap.run)], tmp_path / "c.png")]
    for picture in pictures:
        assert picture.read_bytes().startswith(b"\x89PNG")
        assert picture.stat().st_size > 10_000
