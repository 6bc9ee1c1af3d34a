"""Figure of what a dataset covers; requires the `[viz]` extra."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from egp_service.data.coverage import LATERAL, SPEEDS, THIN, span
from egp_service.files import replacing

if TYPE_CHECKING:
    from pathlib import Path

    from egp_service.data.coverage import Coverage


def draw_coverage(coverage: Coverage, title: str, path: Path) -> None:
    """Draw the time in each bin of speed and lateral acceleration; thin bins have red numbers."""
    time = coverage.time.T
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    ax = figure.subplots()
    shown = np.where(time > 0.0, time, np.nan)
    most = max(float(time.max()), 10.0 * THIN)
    image = ax.imshow(
        shown, origin="lower", aspect="auto", cmap="Blues", norm=LogNorm(0.1 * THIN, most)
    )
    for (i, j), seconds in np.ndenumerate(time):
        if seconds > 0.0:
            colour = "#c2410c" if seconds < THIN else "white" if seconds > 0.2 * most else "black"
            ax.text(j, i, f"{seconds:.2g}" if seconds < 10 else f"{seconds:.0f}",  # noqa: PLR2004
                    ha="center", va="center", color=colour)  # fmt: skip
    ax.set_xticks(range(len(SPEEDS) - 1), [span(SPEEDS, i) for i in range(len(SPEEDS) - 1)])
    ax.set_yticks(range(len(LATERAL) - 1), [span(LATERAL, i) for i in range(len(LATERAL) - 1)])
    ax.tick_params(axis="x", labelsize=8)
    ax.set(xlabel="speed [m/s]", ylabel="lateral acceleration [m/s²]")
    ax.set_title(f"{title}: seconds of data; red below {THIN:g} s", loc="left")
    figure.colorbar(image, ax=ax, label="s")
    with replacing(path) as beside:
        figure.savefig(beside, dpi=150)
