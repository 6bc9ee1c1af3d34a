"""Our QP solver beside Clarabel, PIQP, DAQP, OSQP, ProxQP and HPIPM: the same problems, one run.

The problems are those of cars that follow winding roads at about their grip: 7 states, 2 inputs,
hard bounds on inputs and their rates, soft bounds on states and track edges, new matrices at every
stage. Three in four have active hard bounds. Each solver gets them cold, and warm from its own
solution of the step before, shifted.

Read the table from the right: a time counts only if the solutions are right. "KKT" is the residual
of the optimality conditions by a check that sees nothing but the inputs; "solved" is the share of
problems below 1e-6. All times are the solvers' own, on one core, without Python. Ours includes
reading the problem and its own check; DAQP's leaves out the condensing, HPIPM's the setting of the
data. HPIPM from PyPI is not tuned to this machine: expect a tuned build to be 1.3 to 1.6 times
faster.

Rivals need `pip install daqp proxsuite comma-deps-acados` (HPIPM, with gcc); what is not installed
is left out.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from qp_problems import drive, residual
from qp_rivals import RIVALS, TARGET, Answer, Hpipm, missing
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Iterator

    from qp_problems import Step
    from qp_rivals import Rival

ACCURACY = 1e-6
STEPS = 10


@dataclass
class Row:
    """One solver on the problems of one horizon."""

    name: str
    horizon: int
    warm: bool
    microseconds: list[float]
    iterations: float
    kkt: list[float]

    @property
    def percentiles(self) -> list[float]:
        """Return p50, p95 and p99 in microseconds."""
        return [float(p) for p in np.percentile(self.microseconds, [50, 95, 99])]


def judge(name: str, steps: list[Step], answers: list[Answer], *, warm: bool) -> Row:
    """Summarise the results; the first problem of a drive has no warm start."""
    pairs = [(s, a) for s, a in zip(steps, answers, strict=True) if not (warm and s.first)]
    return Row(
        name,
        len(steps[0].problem["c"]),
        warm,
        [1e6 * answer.seconds for _, answer in pairs],
        float(np.median([answer.iterations for _, answer in pairs])),
        [residual(step.problem, answer.u) for step, answer in pairs],
    )


def ask(rival: type[Rival], steps: list[Step], repeats: int, *, warm: bool) -> Iterator[Answer]:
    """Solve the problems in order, each drive by a new solver."""
    solver = rival(repeats)
    for step in steps:
        if step.first:
            solver = rival(repeats)
        yield solver.solve(step, warm=warm)


def measure(horizon: int, options: argparse.Namespace, progress: Progress) -> list[Row]:
    """Run every solver on the problems of one horizon."""
    task = progress.add_task(f"horizon {horizon}: problems", total=options.drives)
    steps: list[Step] = []
    for seed in range(options.drives):
        steps += drive(seed, horizon, STEPS)
        progress.advance(task)
    rows: list[Row] = []
    for rival, (name, package, starts) in RIVALS.items():
        if missing(package):
            continue
        for warm in (False, True) if starts else (False,):
            label = f"horizon {horizon}: {name}{', warm' if warm else ''}"
            task = progress.add_task(label, total=len(steps))
            answers = []
            for answer in ask(rival, steps, options.repeats, warm=warm):
                answers.append(answer)
                progress.advance(task)
            rows.append(judge(name, steps, answers, warm=warm))
    if not missing("acados"):
        hpipm = Hpipm(options.repeats)
        # Started from the shifted primal and dual solution, the better of its two warm starts.
        for warm in (False, True):
            answers = hpipm.solve_all(steps, warm=2 * warm, tolerance=1e-6)
            rows.append(judge("HPIPM", steps, answers, warm=warm))
    return rows


def show(rows: list[Row], console: Console) -> None:
    """Print a table for each horizon."""
    for horizon in sorted({row.horizon for row in rows}):
        table = Table(title=f"horizon {horizon}, {len(rows[0].kkt)} problems, us")
        for column in ("", "start", "p50", "p95", "p99", "ours is", "iterations"):
            table.add_column(column, justify="left" if column in {"", "start"} else "right")
        for column in ("KKT p50", "KKT worst", "solved"):
            table.add_column(column, justify="right")
        here = [row for row in rows if row.horizon == horizon]
        ours = {row.warm: row.percentiles[0] for row in here if row.name == "ours"}
        for row in here:
            p50, p95, p99 = row.percentiles
            solved = float(np.mean(np.array(row.kkt) <= ACCURACY))
            table.add_row(
                row.name,
                "warm" if row.warm else "cold",
                f"{p50:.0f}",
                f"{p95:.0f}",
                f"{p99:.0f}",
                "" if row.name == "ours" else f"{p50 / ours[row.warm]:.1f}x",
                f"{row.iterations:.0f}",
                f"{np.median(row.kkt):.0e}",
                f"{np.max(row.kkt):.0e}",
                f"{solved:.1%}",
            )
        console.print(table)


def draw(rows: list[Row], path: Path) -> None:
    """Draw the median of each solver, with a line to its p99, a panel for each horizon."""
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("Agg")
    import matplotlib.pyplot as plt  # noqa: PLC0415

    horizons = sorted({row.horizon for row in rows})
    figure, panels = plt.subplots(
        1, len(horizons), figsize=(4.2 * len(horizons), 4.5), sharex=True, squeeze=False
    )
    for horizon, panel in zip(horizons, panels[0], strict=True):
        here = [row for row in rows if row.horizon == horizon][::-1]
        for place, row in enumerate(here):
            p50, _, p99 = row.percentiles
            right = np.mean(np.array(row.kkt) <= ACCURACY) >= 0.99
            colour = "tab:blue" if row.name == "ours" else "tab:grey"
            panel.barh(place, p50, color=colour, alpha=0.55 if row.warm else 1.0)
            panel.plot([p50, p99], [place, place], color="black", linewidth=1)
            if not right:
                panel.text(p99, place, " inaccurate", va="center", fontsize=7)
        names = [f"{row.name}{' warm' if row.warm else ''}" for row in here]
        panel.set_yticks(range(len(here)), names, fontsize=8)
        panel.set_xscale("log")
        panel.set_title(f"horizon {horizon}")
        panel.set_xlabel("time of a solve [us]: median, line to p99")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--horizons", type=int, nargs="+", default=[10, 20, 40], metavar="T")
    parser.add_argument("--drives", type=int, default=20, help=f"cars; {STEPS} problems each")
    parser.add_argument("--repeats", type=int, default=3, help="solves a problem; the best counts")
    parser.add_argument("--picture", type=Path, default=TARGET / "bench" / "qp.png")
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    console = Console(width=max(100, Console().width))
    absent = [package for _, package, _ in RIVALS.values() if missing(package)]
    absent += ["comma-deps-acados"] if missing("acados") else []
    if absent:
        console.print(f"left out, not installed: {', '.join(absent)}")
    rows: list[Row] = []
    with Progress(console=console, transient=True) as progress:
        for horizon in options.horizons:
            rows += measure(horizon, options, progress)
    show(rows, console)
    if not missing("acados"):
        console.print("HPIPM: PyPI's build, 1.3 to 1.6 times slower than one tuned to the machine")
    if not missing("matplotlib"):
        draw(rows, options.picture)
        console.print(f"picture: {options.picture}")


if __name__ == "__main__":
    main()
