"""Steps with eight active members of 700 points and standard deviations, on one core and on all."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from circle import SETTINGS, WINDOW, drive, make_members, write
from rich.table import Table
from timing import microseconds

from egp_service._core import Engine

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

COUNTS = (2, 8)
ROUNDS = 20
# Keeps the weights at their start, so that every member is active.
HELD = SETTINGS.replace(
    f"window = {WINDOW}", f'window = {WINDOW}\nprior = {{kind = "quadratic", lambda = 1e9}}'
)


def compare(console: Console, progress: Progress, periods: int) -> None:
    """Measure and print; the replies are the same bytes."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    task = progress.add_task("members of 700 points", total=COUNTS[-1])
    members = make_members(COUNTS[-1], lambda: progress.advance(task))
    table = Table(title="One step with sigma, all members active, us")
    for column in ("members", "cores", "p50", "p95", "p99"):
        table.add_column(column, justify="right")
    with tempfile.TemporaryDirectory() as folder:
        for count in COUNTS:
            path = Path(folder) / "library.safetensors"
            write(path, members[:count])
            held = np.full(count, 1.0 / count)
            requests = drive(path, periods, want_sigma=True, settings=HELD, weights=held)
            engines = {each: Engine(str(path), HELD, cores=each) for each in (1, cores or 1)}
            replies = [
                [engine.step(request) for request in requests] for engine in engines.values()
            ]
            if any(other != replies[0] for other in replies):
                raise SystemExit("the replies are not the same bytes")
            for each, engine in engines.items():
                seconds = []
                for request in requests * ROUNDS:
                    start = time.perf_counter()
                    engine.step(request)
                    seconds.append(time.perf_counter() - start)
                table.add_row(str(count), str(each), *microseconds(seconds))
    console.print(table)
