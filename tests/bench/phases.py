"""Times of the phases of a step, from the results of criterion in `target/criterion`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

if TYPE_CHECKING:
    from rich.console import Console

CRITERION = Path(__file__).parents[2] / "target" / "criterion"
PHASES = {
    "weights": "phase_weights N=2",
    "linearise, 2 members": "phase_linearise",
    "assemble the QP": "phase_assemble",
    "solve the QP, cold": "phase_solve Riccati",
    "check the solution": "phase_check",
}
WHOLE = {"step, warm": "step Riccati_warm", "step, cold": "step Riccati_cold"}


def median(benchmark: str) -> tuple[float, float, float] | None:
    """Return criterion's median and its confidence interval, us, or None if it did not run."""
    path = CRITERION / benchmark / "new" / "estimates.json"
    if not path.exists():
        return None
    estimate = json.loads(path.read_text())["median"]
    interval = estimate["confidence_interval"]
    numbers = estimate["point_estimate"], interval["lower_bound"], interval["upper_bound"]
    point, low, high = (float(number) / 1e3 for number in numbers)
    return point, low, high


def compare(console: Console, picture: Path) -> None:
    """Print and draw."""
    found = {name: median(key) for name, key in (PHASES | WHOLE).items()}
    if any(numbers is None for numbers in found.values()):
        console.print("phases: no numbers yet; run `cargo bench -p egp-bench --bench step` first")
        return
    known = {name: numbers for name, numbers in found.items() if numbers is not None}
    table = Table(title="Phases of a step, 2 members x 700 points, horizon 20, criterion, us")
    for column in ("", "median", "95 % from", "to"):
        table.add_column(column, justify="right" if column else "left")
    for name, numbers in known.items():
        table.add_row(name, *(f"{number:.1f}" for number in numbers))
    console.print(table)
    draw({name: known[name][0] for name in PHASES}, picture)
    console.print(f"picture: {picture}")


def draw(medians: dict[str, float], picture: Path) -> None:
    """Draw a bar for each phase."""
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(figsize=(6.0, 2.5), layout="constrained")
    names = list(medians)[::-1]
    bars = axes.barh(names, [medians[name] for name in names], color="tab:blue")
    axes.bar_label(bars, fmt="%.1f", padding=3)
    axes.set_xlabel("median [us]")
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=150)
    plt.close(figure)
