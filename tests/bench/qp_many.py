"""Solve many varied problems of each horizon and count those without a solution.

The problems are those of `qp.py`, of other drives. Each is solved cold, and from the shifted
solution of the problem before. A problem is unsolved if its status is not "solved", to which the
check of the KKT residual belongs. Clarabel solves some of the problems as well, and the largest
difference of an input is recorded. The command fails if a problem is unsolved.

    python tests/bench/qp_many.py --problems 10000
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
from itertools import count, islice
from typing import TYPE_CHECKING

import numpy as np
from qp_problems import arguments, drive
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from egp_service._core import solve_ocp

if TYPE_CHECKING:
    from collections.abc import Iterator

    from qp_problems import Array, Step

STEPS = 10
# The drives of `qp.py` have the seeds below.
FIRST_SEED = 1000


@dataclass
class Tally:
    """What became of the problems of one horizon and start."""

    problems: int = 0
    unsolved: int = 0
    fallback: int = 0
    worst: float = 0.0
    apart: list[float] = field(default_factory=list)

    def add(self, step: Step, guess: Array | None, exact: Array | None) -> Array:
        """Solve a problem; return its inputs (T, 2)."""
        result = solve_ocp(*arguments(step.problem), guess=guess)
        self.problems += 1
        self.unsolved += result.status != "solved"
        self.fallback += result.solver != "riccati"
        self.worst = max(self.worst, result.kkt_residual)
        if exact is not None:
            self.apart.append(float(np.abs(result.u - exact).max()))
        return result.u


def problems(horizon: int) -> Iterator[Step]:
    """Yield the problems of one drive after the other."""
    for seed in count(FIRST_SEED):
        yield from drive(seed, horizon, STEPS)


def row(horizon: int, start: str, tally: Tally) -> list[str]:
    """Return the cells of one row of the table."""
    apart = np.percentile(tally.apart, [50, 99, 100]) if tally.apart else [np.nan] * 3
    numbers = [horizon, start, tally.problems, tally.unsolved, tally.fallback]
    return [*map(str, numbers), f"{tally.worst:.0e}", *(f"{value:.0e}" for value in apart)]


def main() -> None:
    """Solve, count, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--horizons", type=int, nargs="+", default=[10, 20, 40], metavar="T")
    parser.add_argument("--problems", type=int, default=10000, help="problems of each horizon")
    parser.add_argument(
        "--compare", type=int, default=7, help="one problem in so many with Clarabel"
    )
    options = parser.parse_args()
    console = Console(width=max(100, Console().width))
    table = Table(title="distance to Clarabel's inputs in m/s^2 and rad/s")
    for column in ("T", "start", "problems", "unsolved", "by the fallback", "KKT worst"):
        table.add_column(column, justify="right")
    for column in ("apart p50", "p99", "largest"):
        table.add_column(column, justify="right")
    unsolved = 0
    with Progress(console=console, transient=True) as progress:
        for horizon in options.horizons:
            cold, warm = Tally(), Tally()
            last = np.zeros((horizon, 2))
            task = progress.add_task(f"horizon {horizon}", total=options.problems)
            for number, step in enumerate(islice(problems(horizon), options.problems)):
                exact = None
                if number % options.compare == 0:
                    exact = solve_ocp(*arguments(step.problem), solver="clarabel").u
                u = cold.add(step, None, exact)
                if not step.first:
                    warm.add(step, np.vstack([last[1:], last[-1:]]), exact)
                last = u
                progress.advance(task)
            for start, tally in (("cold", cold), ("warm", warm)):
                table.add_row(*row(horizon, start, tally))
                unsolved += tally.unsolved
    console.print(table)
    if unsolved:
        sys.exit(f"{unsolved} solves gave no solution")


if __name__ == "__main__":
    main()
