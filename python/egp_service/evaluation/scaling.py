"""Time of a control step over the number of members (the paper, experiment 6)."""

from __future__ import annotations

import contextlib
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import Engine, Library, write_library_subset
from egp_service.closed_loop import drive
from egp_service.controller import Controller
from egp_service.toml_text import dumps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from egp_service.scenario import Scenario
    from egp_service.trace import Period

MEMBERS: Final = (1, 2, 4, 8, 16, 32, 64)


@dataclass(frozen=True, slots=True)
class StepTime:
    """Step times of one program at one number of members."""

    program: str
    members: int
    p50_ms: float
    p95_ms: float


def measure(
    library: Path, scenario: Scenario, *, periods: int, members: Sequence[int] = MEMBERS
) -> list[StepTime]:
    """Time our step on requests of a recorded drive, for libraries of copies of the same members.

    Copies share their weight, so the number of members that count is bounded by the settings; that
    is what keeps the time flat, and the reply says what was left out.
    """
    source = Library.load(library)
    times = []
    with tempfile.TemporaryDirectory() as folder:
        for count in members:
            path = Path(folder) / f"{count}.safetensors"
            write_library_subset(library, path, [i % len(source.members) for i in range(count)])
            requests = _record(path, scenario, periods)
            engine = Engine(str(path), dumps(scenario.control))
            taken = []
            for request in requests:
                start = time.perf_counter()
                engine.step(request)
                taken.append(time.perf_counter() - start)
            p50, p95 = 1e3 * np.percentile(taken[len(taken) // 10 :], [50, 95])
            times.append(StepTime("this system", count, float(p50), float(p95)))
    return times


def _record(library: Path, scenario: Scenario, periods: int) -> list[bytes]:
    """Collect the requests of the first periods of a drive."""
    requests: list[bytes] = []

    class Enough(Exception):  # noqa: N818 - ends a drive early, nothing is wrong
        pass

    def keep(period: Period) -> None:
        requests.append(period.step.request)
        if len(requests) == periods:
            raise Enough

    with contextlib.suppress(Enough):
        drive(scenario, Controller(library, dumps(scenario.control)), keep)
    return requests
