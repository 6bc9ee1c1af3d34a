"""The step for 1 to 64 members of 700 points, ours with and without sigma, beside the paper's."""

from __future__ import annotations

import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from circle import HORIZON, SETTINGS, drive, make_members, write
from rich.table import Table
from timing import microseconds, percentiles

from egp_service._core import Engine, Library, decode_reply, decode_request
from egp_service.evaluation.paper_stack import PaperStack

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

COUNTS = (1, 2, 4, 8, 16, 32, 64)
PAPER_UP_TO = 8
REPEATS = 20
# CVXPY canonicalises on the first solve.
PAPER_WARM_UP = 3


@dataclass
class Row:
    """The results for one number of members: times in s and errors of the solutions."""

    members: int
    plain: list[float]
    sigma: list[float]
    paper: list[float]
    kkt: float
    difference: float
    active: int


def ours(engine: Engine, requests: list[bytes]) -> list[float]:
    """Time each request, bytes to bytes, many times."""
    seconds = []
    for _ in range(REPEATS):
        for request in requests:
            start = time.perf_counter()
            engine.step(request)
            seconds.append(time.perf_counter() - start)
    return seconds[len(requests) :]


def measure(count: int, path: Path, periods: int) -> Row:
    """Time one library."""
    library, engine = Library.load(path), Engine(str(path), SETTINGS)
    requests = drive(path, periods, want_sigma=False)
    replies = [decode_reply(engine.step(request)) for request in requests]
    if any(reply.status != "solved" for reply in replies):
        raise SystemExit(f"{count} members: a step was not solved; is the extension up to date?")
    row = Row(
        members=count,
        plain=ours(engine, requests),
        sigma=ours(engine, drive(path, periods, want_sigma=True)),
        paper=[],
        kkt=max(reply.kkt_residual for reply in replies),
        difference=np.nan,
        active=max(int(np.sum(reply.weights > 1e-3)) for reply in replies),
    )
    if count <= PAPER_UP_TO:
        settings = tomllib.loads(engine.settings_toml)
        stack = PaperStack(path, library, settings)
        differences = []
        for request, reply in zip(requests, replies, strict=True):
            step = stack.step(decode_request(request))
            row.paper.append(step.phases.total)
            scaled = (reply.plan_u - step.plan_u)[0] / [settings["mass"], 1.0]
            differences.append(np.abs(scaled).max())
        row.paper = row.paper[PAPER_WARM_UP:]
        row.difference = float(np.median(differences))
    return row


def compare(console: Console, progress: Progress, picture: Path, periods: int) -> None:
    """Measure, print and draw."""
    task = progress.add_task("members of 700 points", total=COUNTS[-1])
    members = make_members(COUNTS[-1], lambda: progress.advance(task))
    task = progress.add_task("the step by number of members", total=len(COUNTS))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for count in COUNTS:
            path = Path(folder) / "library.safetensors"
            write(path, members[:count])
            rows.append(measure(count, path, periods))
            progress.advance(task)
    table = Table(
        title=f"One step, bytes to bytes, horizon {HORIZON}, us; the paper's decoded to plan"
    )
    for column in ("members", "that count", "p50", "p95", "p99", "with sigma", "p95", "p99"):
        table.add_column(column, justify="right")
    for column in ("paper's p50", "p95", "p99", "ratio", "KKT worst", "u[0] apart"):
        table.add_column(column, justify="right")
    for row in rows:
        paper = microseconds(row.paper) if row.paper else [""] * 3
        ratio = percentiles(row.paper)[0] / percentiles(row.plain)[0] if row.paper else np.nan
        table.add_row(
            str(row.members),
            str(row.active),
            *microseconds(row.plain),
            *microseconds(row.sigma),
            *paper,
            f"{ratio:.0f}x" if row.paper else "",
            f"{row.kkt:.0e}",
            f"{row.difference:.0e}" if row.paper else "",
        )
    console.print(table)
    console.print(
        "u[0] apart: median distance of the first inputs in m/s^2 and rad/s, OSQP at 1e-5"
    )
    draw(rows, picture)
    console.print(f"picture: {picture}")


def draw(rows: list[Row], picture: Path) -> None:
    """Draw the medians over the number of members."""
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
    for name, series in (
        ("ours", [(row.members, row.plain) for row in rows]),
        ("ours, with sigma", [(row.members, row.sigma) for row in rows]),
        ("the paper's", [(row.members, row.paper) for row in rows if row.paper]),
    ):
        bands = np.array([percentiles(seconds) for _, seconds in series])
        at = [members for members, _ in series]
        axes.plot(at, bands[:, 0], marker="o", label=name)
        axes.fill_between(at, bands[:, 0], bands[:, 2], alpha=0.2)
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.set_xlabel("members of 700 points")
    axes.set_ylabel("time of a step [us]: median, band to p99")
    axes.legend(frameon=False)
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=150)
    plt.close(figure)
