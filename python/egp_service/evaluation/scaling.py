"""Time of a control step over the number of members (experiment 6 of the paper)."""

from __future__ import annotations

import contextlib
import tempfile
import time
import tomllib
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import Engine, Library, decode_request, write_library_subset
from egp_service.control.controller import Controller
from egp_service.control.toml_text import dumps
from egp_service.evaluation.experiments import FOUR
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.scenario import gate_settings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from egp_service.simulation.scenario import Scenario
    from egp_service.simulation.trace import Period

MEMBERS: Final = (1, 2, 4, 8, 16, 32, 64)
OURS: Final = "this system"
PAPER: Final = "the paper's stack"
_PAPER_UP_TO: Final = 8  # members, for which a step takes 0.1 s
_PAPER_REQUESTS: Final = 20
_PAPER_WARM_UP: Final = 3  # CVXPY canonicalises on the first solve


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
    """Time the step on requests of a recorded drive, for libraries of copies of four members.

    Copies share their weight, and the settings bound the number of active members, which bounds the
    time; the reply contains the weight of the members left out. The paper's stack is timed with up
    to 8 members from the decoded request to its plan if CVXPY and OSQP are installed.
    """
    times = []
    installed = all(find_spec(package) for package in ("gpytorch", "cvxpy", "osqp"))
    with tempfile.TemporaryDirectory() as folder:
        for count in members:
            path = Path(folder) / f"{count}.safetensors"
            write_library_subset(library, path, [FOUR[i % len(FOUR)] for i in range(count)])
            requests = _record(path, scenario, periods)
            engine = Engine(str(path), dumps(scenario.control))
            times.append(_step_time(OURS, count, _ours(engine, requests)))
            if count <= _PAPER_UP_TO and installed:
                times.append(_step_time(PAPER, count, _paper(path, engine, requests)))
    return times


def _ours(engine: Engine, requests: Sequence[bytes]) -> list[float]:
    """Seconds of each step from request bytes to reply bytes, without the first tenth."""
    taken = []
    for request in requests:
        start = time.perf_counter()
        engine.step(request)
        taken.append(time.perf_counter() - start)
    return taken[len(taken) // 10 :]


def _paper(path: Path, engine: Engine, requests: Sequence[bytes]) -> list[float]:
    """Seconds of each step of the paper's stack, which requires a full window."""
    import torch  # noqa: PLC0415

    from egp_service.evaluation.paper_stack import PaperStack  # noqa: PLC0415

    torch.set_num_threads(1)  # more threads do not speed up matrices of this size
    stack = PaperStack(path, Library.load(path), tomllib.loads(engine.settings_toml))
    full = requests[stack.window + 1 :][:_PAPER_REQUESTS]
    return [stack.step(decode_request(r)).phases.total for r in full][_PAPER_WARM_UP:]


def _step_time(program: str, members: int, seconds: Sequence[float]) -> StepTime:
    p50, p95 = 1e3 * np.percentile(seconds, [50, 95])
    return StepTime(program, members, float(p50), float(p95))


def _record(library: Path, scenario: Scenario, periods: int) -> list[bytes]:
    """Return the requests of the first periods of a drive."""
    requests: list[bytes] = []

    class Enough(Exception):  # noqa: N818 - ends the drive early, not an error
        pass

    def keep(period: Period) -> None:
        requests.append(period.step.request)
        if len(requests) == periods:
            raise Enough

    with contextlib.suppress(Enough):
        gate = gate_settings(scenario)
        drive(scenario, Controller(library, dumps(scenario.control), gate=gate), keep)
    return requests
