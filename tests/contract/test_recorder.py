"""Recordings whose writing fails or is interrupted, and those that cannot be begun or read."""

from __future__ import annotations

import resource
import signal
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from google.protobuf.timestamp_pb2 import Timestamp

from egp_service import Controller, InvalidArgumentError, Plant, Recorder
from egp_service.control.recorded import RecordingError, read_recording
from egp_service.control.recorder import FLUSH_STEPS
from egp_service.shipped import DEMO_LIBRARY

if TYPE_CHECKING:
    from collections.abc import Iterator
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
