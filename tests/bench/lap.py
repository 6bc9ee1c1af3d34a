"""One lap in closed loop, recorded as the bytes that a client sends: ours beside the paper's stack.

Ours is timed from request bytes to reply bytes; the paper's from the decoded request to its plan.
"""

from __future__ import annotations

import time
import tomllib
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table
from timing import microseconds, percentiles

from egp_service._core import Engine, Library, decode_reply, decode_request
from egp_service.control.controller import Controller
from egp_service.evaluation.paper_stack import PaperStack
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.scenario import (
    gate_settings,
    library_path,
    load_scenario,
    told_zones,
)

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from rich.console import Console
    from rich.progress import Progress

KINDS = ("riccati", "clarabel")


def compare(
    console: Console, progress: Progress, picture: Path, scenario_name: str, count: int
) -> None:
    """Record, time, print and draw."""
    scenario = told_zones(load_scenario(scenario_name))
    path = library_path(scenario)
    library = Library.load(path)
    engines = {name: Engine(str(path), f'[solver]\nkind = "{name}"') for name in KINDS}
    requests: list[bytes] = []
    task = progress.add_task("a lap", total=None)
    with Controller(path, gate=gate_settings(scenario)) as controller:
        drive(scenario, controller, lambda period: requests.append(period.step.request))
    progress.update(task, total=1, completed=1)
    settings = tomllib.loads(engines["riccati"].settings_toml)
    requests = requests[settings["weights"]["window"] + 1 :]  # the paper's has no shorter window

    seconds: dict[str, list[float]] = {name: [] for name in (*engines, "paper")}
    for name, engine in engines.items():
        for request in progress.track(requests * 3, description=f"the lap, {name}"):
            start = time.perf_counter()
            engine.step(request)
            seconds[name].append(time.perf_counter() - start)

    stack = PaperStack(path, library, settings)
    with_our_slopes = PaperStack(path, library, settings, vehicle_slopes=True)
    phases: list[tuple[float, float, float]] = []
    difference: list[float] = []
    sample = requests[:: max(1, len(requests) // count)]
    for n, request in enumerate(progress.track(sample, description="the lap, the paper's stack")):
        step = stack.step(decode_request(request))
        if n < 3:  # CVXPY canonicalises on the first solve
            continue
        seconds["paper"].append(step.phases.total)
        phases.append((step.phases.weights, step.phases.linearise, step.phases.mpc))
        ours = decode_reply(engines["riccati"].step(request))
        alike = with_our_slopes.step(decode_request(request))
        difference.append(worst(ours.plan_u - alike.plan_u, settings["mass"]))

    points = [member.n_points for member in library.members]
    table = Table(title=f"A step on a lap, members of {points} points, horizon {stack.horizon}, us")
    for column in ("", "p50", "p95", "p99", "the paper's is"):
        table.add_column(column, justify="right" if column else "left")
    reference = percentiles(seconds["paper"])[0]
    for name, times in seconds.items():
        ratio = f"{reference / percentiles(times)[0]:.0f}x"
        table.add_row(name, *microseconds(times), ratio)
    console.print(table)
    weights, linearise, mpc = np.median(np.array(phases), axis=0) * 1e3
    console.print(
        f"paper: weights {weights:.1f} ms, linearise {linearise:.1f} ms, MPC {mpc:.1f} ms"
    )
    console.print(
        "largest difference of the first input, scaled: "
        f"median {np.median(difference):.1e}, worst {np.max(difference):.1e} "
        "(the paper's problem with our slopes; no proximal term, fewer bounds; OSQP at 1e-5)"
    )
    draw(seconds, picture)
    console.print(f"picture: {picture}")


def worst(difference: NDArray[np.float64], mass: float) -> float:
    """Return the largest difference of the first input, in m/s^2 and rad/s."""
    return float(np.abs(difference[0] / [mass, 1.0]).max())


def draw(seconds: dict[str, list[float]], picture: Path) -> None:
    """Draw the share of steps over their time."""
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(figsize=(6.0, 3.5), layout="constrained")
    for name, times in seconds.items():
        axes.ecdf(np.array(times) * 1e6, label=name)
    axes.set_xscale("log")
    axes.set_xlabel("time of a step [us]")
    axes.set_ylabel("share of steps that took no longer")
    axes.legend(frameon=False)
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=150)
    plt.close(figure)
