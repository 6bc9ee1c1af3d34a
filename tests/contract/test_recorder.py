"""Recordings whose writing fails or is interrupted, and those that cannot be begun or read."""

from __future__ import annotations

import json
import resource
import signal
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import Writer
from typer.testing import CliRunner

from egp_service import Controller, InvalidArgumentError, Plant, Recorder
from egp_service.cli import app
from egp_service.control.recorded import RecordingError, read_recording
from egp_service.control.recorder import ABOUT, FLUSH_STEPS
from egp_service.shipped import DEMO_LIBRARY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from egp_service import Step

X = [0.0, 0.1, 15.0, 0.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def controller() -> Iterator[Controller]:
    with Controller(DEMO_LIBRARY, gate=Plant().parameters.gate_limits()) as opened:
        yield opened


@pytest.fixture(scope="module")
def step(controller: Controller) -> Step:
    s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
    return controller.step(X, np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s]), deadline=5.0)


@contextmanager
def limited(size: int) -> Iterator[None]:
    """Let files of this process grow to at most `size` bytes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_ends_a_recording_that_stays_readable(
    tmp_path: Path, controller: Controller, step: Step
) -> None:
    file = tmp_path / "run.mcap"
    recorder = Recorder(file, controller)
    for k in range(2 * FLUSH_STEPS):
        recorder.add(step, X, 0.02 * k)
    for k in range(FLUSH_STEPS - 1):
        recorder.add(step, X, 2.0 + 0.02 * k)
    with limited(file.stat().st_size + 100), pytest.raises(OSError, match="large") as caught:
        recorder.add(step, X, 2.98)
    assert caught.value.filename == str(file)
    # There is room again, but the file may lack steps in between.
    with pytest.raises(InvalidArgumentError, match=r"has ended, because .* OSError"):
        recorder.add(step, X, 4.0)
    with pytest.raises(InvalidArgumentError, match="has ended"):
        recorder.message("/note", Timestamp(), 4.0)
    recorder.close()
    read = read_recording(file)
    assert (len(read.steps), read.complete) == (2 * FLUSH_STEPS, False)
    assert "interrupted" in read.missing
    other = tmp_path / "other.mcap"
    with limited(100), pytest.raises(OSError, match="large") as caught:
        Recorder(other, controller)
    assert caught.value.filename == str(other)
    assert not other.exists()
    other.write_bytes(b"what was recorded before")
    with limited(100), pytest.raises(OSError, match="large"):
        Recorder(other, controller)
    assert other.read_bytes() == b"what was recorded before"
    assert set(tmp_path.iterdir()) == {file, other}


def test_a_time_that_runs_backward_is_an_error(
    tmp_path: Path, controller: Controller, step: Step
) -> None:
    with Recorder(tmp_path / "run.mcap", controller) as recorder:
        recorder.add(step, X, 0.02)
        recorder.add(step, X, 0.02)
        with pytest.raises(
            InvalidArgumentError, match=r"0\.01 s is before that of the last step, 0"
        ):
            recorder.add(step, X, 0.01)
    assert len(read_recording(tmp_path / "run.mcap").steps) == 2


@pytest.mark.parametrize("time", [-1.0, 1e12, float("nan"), float("inf")])
def test_a_message_at_no_time_leaves_the_recording(
    tmp_path: Path, controller: Controller, step: Step, time: float
) -> None:
    file = tmp_path / "run.mcap"
    with Recorder(file, controller) as recorder:
        recorder.add(step, X, 0.02)
        with pytest.raises(InvalidArgumentError, match="expected for time the seconds since"):
            recorder.message("/note", Timestamp(), time)
        recorder.message("/note", Timestamp(), 0.01)
        recorder.add(step, X, 0.04)
    read = read_recording(file)
    assert (len(read.steps), read.complete) == (2, True)


def test_steps_of_two_controllers_have_their_own_replies(tmp_path: Path) -> None:
    file, limits = tmp_path / "run.mcap", Plant().parameters.gate_limits()
    with (
        Controller(DEMO_LIBRARY, gate=limits) as first,
        Controller(DEMO_LIBRARY, gate=limits) as second,
        Recorder(file, first) as recorder,
    ):
        s = 15.0 * first.dt * np.arange(first.horizon + 1)
        reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
        steps = []
        for k in range(3):
            for controller, y in ((first, 0.1), (second, -0.2)):
                x = [0.0, y, *X[2:]]
                steps.append(controller.step(x, reference, deadline=5.0))
                recorder.add(steps[-1], x, 0.02 * k)
    assert [read.reply for read in read_recording(file).steps] == [step.reply for step in steps]


class Interrupted(BaseException):
    """Comes at any instruction, as a `KeyboardInterrupt` does."""


def test_an_interruption_tears_no_recording(
    tmp_path: Path, controller: Controller, step: Step
) -> None:
    def interrupt(*_: object) -> None:
        raise Interrupted

    before = signal.signal(signal.SIGALRM, interrupt)
    torn = 0
    try:
        for attempt in range(60):
            file, added = tmp_path / f"{attempt}.mcap", 0
            try:
                with Recorder(file, controller) as recorder:
                    signal.setitimer(signal.ITIMER_REAL, 0.002 + 0.0005 * attempt)
                    for k in range(10_000):
                        recorder.add(step, X, 0.02 * k)
                        added += 1
            except Interrupted:
                read = read_recording(file)
                assert added + 1 >= len(read.steps) > added - FLUSH_STEPS - 1
                assert len(read.steps) >= added or not read.complete
                torn += not read.complete
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert torn > 0, "no interruption came while a step was written"


@pytest.mark.parametrize(
    "notes", [{"x": 3}, {"x": {"a": 1}}, {"x": {"a": "\ud800"}}, {"egp.about": {"a": "b"}}]
)
def test_wrong_notes_leave_the_file_that_is_there(
    tmp_path: Path, controller: Controller, notes: dict[str, Any]
) -> None:
    file = tmp_path / "old.mcap"
    file.write_bytes(b"what was recorded before")
    with pytest.raises(InvalidArgumentError, match="notes"):
        Recorder(file, controller, notes=notes)
    assert file.read_bytes() == b"what was recorded before"


def test_a_damaged_head_is_an_error_in_words(
    tmp_path: Path, controller: Controller, step: Step
) -> None:
    file, damaged = tmp_path / "run.mcap", tmp_path / "damaged.mcap"
    with Recorder(file, controller) as recorder:
        recorder.add(step, X, 0.0)
    whole, errors = file.read_bytes(), 0
    for place in range(0, 2500, 3):
        data = bytearray(whole)
        data[place] ^= 8
        damaged.write_bytes(data)
        try:
            read_recording(damaged)
        except RecordingError:
            errors += 1
    assert errors > 10


@pytest.fixture
def other(tmp_path: Path, step: Step) -> Callable[[dict[str, str]], Path]:
    """Write a recording of one step with these metadata, as a client in another language may."""
    file, reply = tmp_path / "other.mcap", step.reply
    assert reply is not None

    def write(about: dict[str, str]) -> Path:
        with file.open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            writer.add_metadata(ABOUT, about)
            for topic, data in (("/request", step.request), ("/reply", reply)):
                channel = writer.register_channel(topic, "protobuf", 0)
                writer.add_message(channel, 0, data, 0)
            writer.finish()  # type: ignore[no-untyped-call]
        return file

    return write


def needed(controller: Controller) -> dict[str, str]:
    """Give the metadata without which a recording cannot be replayed."""
    return {
        "library": controller.library.hex(),
        "members": json.dumps(list(controller.members)),
        "dt": str(controller.dt),
        "horizon": str(controller.horizon),
    }


def test_the_recording_of_another_program_can_be_replayed(
    other: Callable[[dict[str, str]], Path], controller: Controller
) -> None:
    file = other(needed(controller))
    result = CliRunner().invoke(app, ["replay", str(file)])
    assert result.exit_code == 0, result.exception
    assert "(mu 0.5, mu 1.1), egp-service not stated with vector instructions" in result.output
    assert "All 1 replies have the same bytes as recorded." in result.output
    read = read_recording(file)
    assert (read.dt, read.horizon) == (controller.dt, controller.horizon)


def test_a_recording_without_steps_is_no_load(tmp_path: Path, controller: Controller) -> None:
    Recorder(tmp_path / "run.mcap", controller).close()
    result = CliRunner().invoke(app, ["load", "--replay", str(tmp_path)])
    assert "has no step to replay" in str(result.exception)


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("library", None, "library is missing: expected the SHA-256 of the library as 64 lower"),
        ("library", "zz", "library is 'zz'"),
        ("library", "0" * 63 + "A", "library is '000000000000...000000000000A'"),
        ("members", None, "members is missing: expected the names of the members as a JSON list"),
        ("members", "mu", "members is 'mu'"),
        ("members", "5", "members is '5'"),
        ("members", "[1, 2]", "members is '[1, 2]'"),
        ("members", "[]", "members is '[]'"),
        ("members", '["\\ud800"]', "members is "),
        ("members", "[" * 100_000, "members is '[[[["),
        ("dt", None, "dt is missing: expected the control period in s, a number above 0"),
        ("dt", "x", "dt is 'x'"),
        ("dt", "0", "dt is '0'"),
        ("dt", "inf", "dt is 'inf'"),
        ("horizon", None, "horizon is missing: expected a whole number from 1 to 128"),
        ("horizon", "x", "horizon is 'x'"),
        ("horizon", "-1", "horizon is '-1'"),
        ("horizon", "129", "horizon is '129'"),
    ],
)
def test_metadata_that_cannot_be_used_are_named(
    other: Callable[[dict[str, str]], Path],
    controller: Controller,
    key: str,
    value: str | None,
    told: str,
) -> None:
    about = {name: text for name, text in needed(controller).items() if name != key}
    if value is not None:
        about[key] = value
    file = other(about)
    result = CliRunner().invoke(app, ["replay", str(file)])
    assert isinstance(result.exception, RecordingError)
    assert str(result.exception).startswith(f"{file}: metadata 'egp.about': {told}")
