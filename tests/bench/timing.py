"""One core, one thread, and percentiles, for all comparisons in this folder."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


def pin() -> None:
    """Keep this process on one core, and torch on one thread."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    import torch  # noqa: PLC0415

    torch.set_num_threads(1)


def percentiles(seconds: Sequence[float]) -> tuple[float, float, float]:
    """Return p50, p95 and p99 in microseconds."""
    p50, p95, p99 = np.percentile(np.array(seconds) * 1e6, [50, 95, 99])
    return float(p50), float(p95), float(p99)


def clock(work: Callable[[], object], repeats: int) -> list[float]:
    """Return the seconds of each of `repeats` calls after three warm-up calls."""
    seconds = []
    for _ in range(repeats + 3):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return seconds[3:]


def microseconds(seconds: Sequence[float]) -> list[str]:
    """Print p50, p95 and p99 for a table."""
    return [f"{p:.0f}" if p >= 10.0 else f"{p:.1f}" for p in percentiles(seconds)]
