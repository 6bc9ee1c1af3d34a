"""Figure of the validation matrix."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from egp_service.files import replacing
from egp_service.quantities import GP_OUTPUT

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from egp_service.training.validation import Cell


def draw_validation(matrix: list[list[Cell]], path: Path) -> None:
    """Draw members (rows) against surfaces (columns): RMSE, NLPD and coverage per output.

    Colours are relative to the panel; for coverage they show the distance from 0.95.
    """
    figure = Figure(figsize=(2.2 + 1.0 * 3 * len(matrix[0]), 2.0 + 1.8 * len(matrix)))
    axes = figure.subplots(3, len(GP_OUTPUT), squeeze=False)
    for column, (name, unit) in enumerate(GP_OUTPUT.items()):
        label = name.replace("d_", "Δ")
        rmse = np.array([[cell.rmse[column] for cell in row] for row in matrix])
        nlpd = np.array([[cell.nlpd[column] for cell in row] for row in matrix])
        coverage = np.array([[cell.coverage[column] for cell in row] for row in matrix])
        _panel(axes[0, column], f"RMSE of {label} [{unit}]", np.log(rmse), rmse, "{:.3g}")
        _panel(axes[1, column], f"NLPD of {label}", np.arcsinh(nlpd), nlpd, "{:.2f}")
        _panel(
            axes[2, column], f"95 % coverage of {label}", abs(coverage - 0.95), coverage, "{:.2f}"
        )
    for row in axes:
        row[0].set_yticks(range(len(matrix)), [cells[0].member for cells in matrix])
        row[0].set_ylabel("member")
    for axis in axes[-1]:
        axis.set_xticks(range(len(matrix[0])), [cell.surface for cell in matrix[0]])
        axis.set_xlabel("on surface")
    figure.set_layout_engine("constrained")
    with replacing(path) as beside:
        figure.savefig(beside, dpi=150)


def _panel(
    axis: Axes,
    title: str,
    badness: NDArray[np.float64],
    values: NDArray[np.float64],
    form: str,
) -> None:
    axis.set_title(title, fontsize="medium")
    axis.set_xticks([])
    axis.set_yticks([])
    axis.imshow(badness, cmap="YlOrRd", aspect="auto")
    middle = 0.5 * (badness.min() + badness.max())
    for (i, j), value in np.ndenumerate(values):
        dark = badness[i, j] > middle
        axis.text(
            j, i, form.format(value), ha="center", va="center", color="white" if dark else "black"
        )
