"""Our control step beside the paper's stack and other GP programs, in one run on one core.

Five comparisons, each a table, most a picture in target/bench:
  lap      a lap in closed loop: ours, ours with Clarabel, and the paper's stack (GPyTorch with
           autograd for the members, DPP-parametrised CVXPY with OSQP for the QPs)
  members  the step for 1 to 64 members of 700 points, with and without standard deviations, beside
           the paper's stack up to 8
  cores    the step with standard deviations and eight active members, on one core and on all
  phases   where the time goes; reads what `cargo bench -p egp-bench` left in target/criterion
  gp       mean and Jacobian of a member against numpy, numba and GPyTorch

A time counts only if the answer is right, so each table has its errors. Absolute times are the
machine's; ratios carry over. Close what else runs before you believe a p99.

    python tests/bench/compare.py                        # everything, some minutes
    python tests/bench/compare.py --only gp phases
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cores
import gp
import lap
import matplotlib as mpl
import members
import phases
from rich.console import Console
from rich.progress import Progress
from timing import pin

PICTURES = Path(__file__).parents[2] / "target" / "bench"
SECTIONS = ("cores", "lap", "members", "phases", "gp")


def main() -> None:
    """Run the comparisons that the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=SECTIONS)
    parser.add_argument("--requests", type=int, default=100, help="for the paper's stack, on a lap")
    parser.add_argument("--scenario", default="rounded-rectangle", help="course of the lap")
    parser.add_argument(
        "--periods", type=int, default=100, help="requests for each number of members"
    )
    parser.add_argument("--repeats", type=int, default=100, help="calls of each GP program")
    parser.add_argument("--pictures", type=Path, default=PICTURES)
    options = parser.parse_args()
    mpl.use("Agg")
    console = Console(width=max(120, Console().width))
    pictures: Path = options.pictures
    if "cores" in options.only:
        with Progress(console=console, transient=True) as progress:
            cores.compare(console, progress, options.periods)
    pin()
    with Progress(console=console, transient=True) as progress:
        if "lap" in options.only:
            lap.compare(console, progress, pictures / "lap.png", options.scenario, options.requests)
        if "members" in options.only:
            members.compare(console, progress, pictures / "members.png", options.periods)
    if "phases" in options.only:
        phases.compare(console, pictures / "phases.png")
    if "gp" in options.only:
        gp.compare(console, pictures / "gp.png", options.repeats)


if __name__ == "__main__":
    main()
