"""Whatever ends an evaluation ends its processes at once; called again, it goes on."""

from __future__ import annotations

import io
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NoReturn
from unittest.mock import Mock

import numpy as np
import pytest
from loky.process_executor import ShutdownExecutorError
from rich.console import Console

from egp_service.cli import evaluation_parts
from egp_service.evaluation import batch
from egp_service.workers import WorkerError, workers
from patience import PATIENCE, wait_until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from concurrent.futures import Executor
    from pathlib import Path

LONG = 3600.0  # s


def work_long(mark: Path) -> None:
    mark.touch()
    time.sleep(LONG)


def test_an_exception_ends_workers_and_what_they_have_queued(tmp_path: Path) -> None:
    others = set(multiprocessing.active_children())
    futures: list[Future[None]] = []

    def interrupt_when_busy(pool: Executor) -> NoReturn:
        futures.extend(pool.submit(work_long, tmp_path / str(n)) for n in range(8))
        wait_until(lambda: len(list(tmp_path.iterdir())) == 2)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), workers(2) as pool:
        interrupt_when_busy(pool)
    assert set(multiprocessing.active_children()) <= others
    for future in futures:
        with pytest.raises((CancelledError, ShutdownExecutorError)):
            future.result(PATIENCE)
    assert len(list(tmp_path.iterdir())) == 2


def end_by_the_system() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_worker_is_an_error_in_words() -> None:
    with pytest.raises(WorkerError, match="try fewer with --jobs N"), workers(1) as pool:
        pool.submit(end_by_the_system).result(PATIENCE)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux only")
def test_by_default_there_is_a_process_for_each_core_that_may_be_used() -> None:
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        with workers() as pool:
            assert vars(pool)["_max_workers"] == 1
    finally:
        os.sched_setaffinity(0, cores)


def test_an_evaluation_whose_worker_was_killed_says_how_it_goes_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(evaluation_parts, "finish", Mock(side_effect=WorkerError("killed")))
    console = Console(file=io.StringIO())
    nothing = evaluation_parts.Selection(full=False, chosen=[], driven=[], apart=[])
    with pytest.raises(WorkerError):
        evaluation_parts.run(console, Mock(), nothing, tmp_path, jobs=None, cluster=None)
    assert isinstance(console.file, io.StringIO)
    assert "The same command continues" in console.file.getvalue()


INTERRUPTED_RESULTS = """
from egp_service.workers import workers

for _ in range(5):
    try:
        with workers(2) as pool:
            futures = [pool.submit(bytes, 3_000_000) for _ in range(50)]
            futures[5].result()
            raise KeyboardInterrupt
    except KeyboardInterrupt:
        pass
"""


def test_results_cut_off_in_the_middle_hold_nobody_up() -> None:
    command = [sys.executable, "-c", INTERRUPTED_RESULTS]
    subprocess.run(command, check=True, timeout=2 * PATIENCE)


# Each lap waits for a ticket, so that no evaluation ends before it is interrupted.
TICKETS = """
import time
from pathlib import Path

from egp_service import Plant


def take() -> bool:
    for ticket in Path("tickets").iterdir():
        try:
            ticket.unlink()
        except FileNotFoundError:  # another process took it
            continue
        return True
    return False


class Car:
    def __init__(self):
        self._plant = Plant()

    def reset(self, x):
        while not take():
            time.sleep(0.02)
        p_x, p_y, v_x, psi, v_y, omega, delta = x
        self._plant.reset(p_x, p_y, psi, v_x, yaw_rate=omega, v_y=v_y, delta=delta)

    def step(self, u, dt, friction):
        self._plant.step(u, dt, friction)

    @property
    def state(self):
        return self._plant.vehicle_state
"""


def give(folder: Path, tickets: int) -> None:
    for number in range(tickets):
        (folder / "tickets" / str(number)).touch()


@contextmanager
def evaluation(folder: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Drive twelve laps of 250 m; a failure shows what was printed and what the threads did."""
    (folder / "waiting_car.py").write_text(TICKETS, encoding="utf-8")
    track = folder / "circle.csv"
    angle = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    rows = np.column_stack([40.0 * np.cos(angle), 40.0 * np.sin(angle), np.full((120, 2), 4.0)])
    np.savetxt(track, rows, delimiter=",", header="x_m,y_m,w_tr_right_m,w_tr_left_m")
    command = [sys.executable, "-X", "faulthandler", "-m", "egp_service", "evaluate"]
    command += ["-e", "unseen-track", "--track", str(track), "--plant", "waiting_car:Car"]
    process = subprocess.Popen(
        [*command, "-o", str(folder), *options],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    except BaseException as error:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGABRT)
        output, _ = process.communicate()
        error.add_note(output)
        raise
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _has_gone_on(process: subprocess.Popen[str], log: Path, size: int) -> bool:
    return process.poll() is not None or (log.exists() and log.stat().st_size > size)


def test_an_evaluation_ends_with_its_processes_and_goes_on(tmp_path: Path) -> None:
    log = tmp_path / "runs.jsonl"
    (tmp_path / "tickets").mkdir()
    finished = ""
    one = ("--jobs", "1")
    for send, sent, code, jobs in (
        (os.killpg, signal.SIGINT, 128 + signal.SIGINT, ()),  # Ctrl-C
        (os.kill, signal.SIGINT, 128 + signal.SIGINT, one),
        (os.kill, signal.SIGKILL, -signal.SIGKILL, one),
    ):
        with evaluation(tmp_path, *jobs) as process:
            give(tmp_path, 1)
            wait_until(partial(_has_gone_on, process, log, len(finished)), 5 * PATIENCE)
            with suppress(ProcessLookupError):
                send(process.pid, sent)
            # Until all have closed it.
            output, _ = process.communicate(timeout=5 * PATIENCE)
        assert process.returncode == code, output
        assert "Traceback" not in output
        assert sent == signal.SIGKILL or "The same command continues" in output
        results = log.read_text(encoding="utf-8")
        assert results.startswith(finished)
        finished = results
    with evaluation(tmp_path) as again:
        give(tmp_path, 100)
        output, _ = again.communicate(timeout=5 * PATIENCE)
    assert again.returncode == 0, output
    results = log.read_text(encoding="utf-8")
    assert results.startswith(finished)
    marks = [line.partition(",")[0] for line in results.splitlines() if line]
    assert len(marks) == len(set(marks)) == 12
    assert len(finished.splitlines()) < 12


@dataclass(frozen=True)
class Number:
    """A result."""

    value: int


def fail_at_two(part: int) -> Number:
    if part == 2:
        raise ValueError(f"part {part}")
    return Number(part)


class _Finished:
    """A pool whose work is done when it is submitted."""

    def submit(self, work: Callable[[int], Number], part: int) -> Future[Number]:
        future: Future[Number] = Future()
        try:
            future.set_result(work(part))
        except ValueError as error:
            future.set_exception(error)
        return future


def test_what_was_finished_while_a_part_failed_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "workers", lambda *_: nullcontext(_Finished()))
    kept: list[Number] = []
    parts = {str(part): part for part in range(6)}
    work = batch.Batch(
        tmp_path / "a.jsonl", parts, fail_at_two, lambda found: Number(**found), kept.append
    )
    with pytest.raises(ValueError, match="part 2") as caught:
        batch.finish([work])
    assert caught.value.__notes__ == ["in 2"]
    assert sorted(number.value for number in kept) == [0, 1, 3, 4, 5]
    assert work.resume() == ["2"]
