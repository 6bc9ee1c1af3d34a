"""Our control step beside the paper's stack: the same library, the same requests, in one run.

Requests are those of a lap in closed loop, recorded as the bytes that a client sends. Ours is timed
from request bytes to reply bytes; the paper's stack from the decoded request to its plan. Both run
on one thread of one core.

    python tests/bench/compare.py [--requests 100]
"""

from __future__ import annotations

import argparse
import os
import time
import tomllib
from typing import TYPE_CHECKING

import numpy as np
import torch
from paper_stack import PaperStack
from rich.console import Console
from rich.progress import track
from rich.table import Table

from egp_service._core import Engine, Library, decode_reply, decode_request
from egp_service.closed_loop import drive
from egp_service.controller import Controller
from egp_service.scenario import library_path, load_scenario

if TYPE_CHECKING:
    from numpy.typing import NDArray

WARM_UP = 20


def percentiles(seconds: list[float]) -> tuple[float, float, float]:
    """Return p50, p95 and p99 in microseconds."""
    p50, p95, p99 = np.percentile(np.array(seconds) * 1e6, [50, 95, 99])
    return float(p50), float(p95), float(p99)


def main() -> None:
    """Record, time, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--requests", type=int, default=100, help="requests for the paper's stack")
    parser.add_argument("--scenario", default="rounded-rectangle")
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    torch.set_num_threads(1)

    scenario = load_scenario(options.scenario)
    path = library_path(scenario)
    library = Library.load(path)
    engines = {
        name: Engine(str(path), f'[solver]\nkind = "{name}"') for name in ("riccati", "clarabel")
    }
    requests: list[bytes] = []
    with Controller(path) as controller:
        drive(scenario, controller, lambda period: requests.append(period.step.request))
    requests = requests[WARM_UP:]

    seconds: dict[str, list[float]] = {name: [] for name in (*engines, "paper")}
    for name, engine in engines.items():
        for request in track(requests * 3, f"ours, {name}"):
            start = time.perf_counter()
            engine.step(request)
            seconds[name].append(time.perf_counter() - start)

    settings = tomllib.loads(engines["riccati"].settings_toml)
    stack = PaperStack(path, library, settings)
    phases: list[tuple[float, float, float]] = []
    difference: list[float] = []
    sample = requests[:: max(1, len(requests) // options.requests)]
    for n, request in enumerate(track(sample, "the paper's stack")):
        decoded = decode_request(request)
        step = stack.step(decoded)
        if n < 3:  # CVXPY canonicalises on the first solve
            continue
        seconds["paper"].append(step.phases.total)
        phases.append((step.phases.weights, step.phases.linearise, step.phases.mpc))
        ours = decode_reply(engines["riccati"].step(request))
        difference.append(worst(ours.plan_u - step.plan_u, settings["mass"]))

    table = Table(title=f"One step, {len(library.members)} members, horizon {settings['horizon']}")
    for column in ("", "p50 us", "p95 us", "p99 us", "against the paper's"):
        table.add_column(column, justify="left" if not column else "right")
    reference = percentiles(seconds["paper"])[0]
    for name, times in seconds.items():
        p50, p95, p99 = percentiles(times)
        table.add_row(name, f"{p50:.0f}", f"{p95:.0f}", f"{p99:.0f}", f"{reference / p50:.0f}x")
    console = Console()
    console.print(table)
    weights, linearise, mpc = np.median(np.array(phases), axis=0) * 1e3
    console.print(f"points a member: {[member.n_points for member in library.members]}")
    console.print(
        f"paper: weights {weights:.1f} ms, linearise {linearise:.1f} ms, MPC {mpc:.1f} ms"
    )
    console.print(
        "largest difference of the first input, scaled: "
        f"median {np.median(difference):.1e}, worst {np.max(difference):.1e} (OSQP at 1e-5)"
    )


def worst(difference: NDArray[np.float64], mass: float) -> float:
    """Return the largest difference of the first input, in m/s^2 and rad/s."""
    return float(np.abs(difference[0] / [mass, 1.0]).max())


if __name__ == "__main__":
    main()
