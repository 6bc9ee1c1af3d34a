"""Ctrl-C ends what works in parallel at once, and an evaluation goes on afterwards."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING, NoReturn

import pytest

from egp_service.workers import workers

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future
    from pathlib import Path

LONG = 3600.0  # s
PATIENCE = 60.0


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_an_exception_ends_workers_and_what_they_have_queued() -> None:
    others = set(multiprocessing.active_children())

    def interrupt_when_busy(futures: list[Future[None]]) -> NoReturn:
        wait_until(lambda: sum(future.running() for future in futures) >= 2)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), workers(2) as pool:
        interrupt_when_busy([pool.submit(time.sleep, LONG) for _ in range(8)])
    assert set(multiprocessing.active_children()) <= others


@pytest.mark.parametrize("send", [os.killpg, os.kill])
def test_an_interrupted_evaluation_ends_and_goes_on(
    tmp_path: Path, send: Callable[[int, int], None]
) -> None:
    """As a terminal does it, to all processes, and as `kill -INT` does, to one."""
    log = tmp_path / "runs.jsonl"
    command = [sys.executable, "-m", "egp_service", "evaluate", "-e", "friction-step"]
    process = subprocess.Popen(
        [*command, "-o", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        wait_until(lambda: log.exists() and log.stat().st_size > 0)
        send(process.pid, signal.SIGINT)
        output, _ = process.communicate(timeout=PATIENCE)  # until all have closed it
    finally:
        process.kill()
    assert process.returncode == 128 + signal.SIGINT, output
    assert "The same command goes on" in output
    lines = log.read_text(encoding="utf-8").splitlines()
    assert all(json.loads(line)["outcome"]["experiment"] == "friction-step" for line in lines)
