"""Pictures of the open-loop evaluation on a log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure
from scipy.special import ndtri

from egp_service.files import replacing
from egp_service.quantities import MOTION_LABELS, NORMAL_95
from egp_service.training.open_loop import NO_CHANGE

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from egp_service.evaluation.logs import LogOutcome

_SHOWN: Final = 400  # transitions over time
_LEVELS: Final = np.linspace(0.05, 0.99, 48)
_OUTSIDE: Final = 4.0  # largest residual that is shown, in standard deviations


def draw_log(outcome: LogOutcome, path: Path) -> None:
    """Draw a log's held-out changes: over time, against predictions, residuals, coverage.

    Without changes that count these axes are empty. The last row has the errors of all predictors
    after rollouts and, if there are, the weights of the other logs' members over time.
    """
    held = outcome.member.validation
    moving = held.counts
    measured, predicted = held.y[moving], outcome.predicted[moving]
    deviation = outcome.deviation[moving]
    figure = Figure(figsize=(12.0, 17.0), layout="constrained")
    axes = figure.subplots(6 if outcome.weights is not None else 5, 3, squeeze=False)
    for column, label in enumerate(MOTION_LABELS):
        axes[0, column].set(title=f"change of {label}")
        if moving.any():
            changes = (array[:, column] for array in (measured, predicted, deviation))
            _draw_changes(axes[:4, column], held.provenance.dt, *changes)
        ax = axes[4, column]
        least = outcome.skill.rms[NO_CHANGE][:, column]
        for name, errors in outcome.skill.rms.items():
            style = "--" if name == NO_CHANGE else "-"
            ax.plot(outcome.skill.durations, errors[:, column] / least, style, label=name)
        ax.set(xscale="log", xlabel="s", ylabel="RMS error over that of no change", ylim=(0.0, 2.0))
    if moving.any():
        axes[0, 0].legend(fontsize="small")
    axes[4, 0].legend(fontsize="small")
    if outcome.weights is not None:
        ax = figure.add_subplot(axes[5, 0].get_gridspec()[5, :])
        for row in axes[5]:
            row.remove()
        time = held.provenance.dt * np.arange(len(held))
        for name, weight in zip(outcome.others, outcome.weights.T, strict=True):
            ax.plot(time, weight, lw=0.8, label=f"member of {name}")
        ax.set(xlabel="s of held-out driving", ylabel="weight", title="weights of other members")
        ax.legend(fontsize="small", loc="upper right")
    figure.suptitle(f"{outcome.name}: held-out blocks above {held.least_speed:.3g} m/s")
    with replacing(path) as beside:
        figure.savefig(beside, dpi=110)


def _draw_changes(
    axes: NDArray[np.object_],
    dt: float,
    truth: NDArray[np.float64],
    mean: NDArray[np.float64],
    std: NDArray[np.float64],
) -> None:
    """Draw held-out changes (n,), n > 0, of one output with their predictions on four axes."""
    over_time, against, residuals, coverage = axes
    time = dt * np.arange(min(_SHOWN, len(truth)))
    over_time.plot(time, truth[:_SHOWN], color="0.6", lw=0.8, label="measured")
    over_time.plot(time, mean[:_SHOWN], lw=1.0, label="predicted")
    band = NORMAL_95 * std[:_SHOWN]
    over_time.fill_between(time, mean[:_SHOWN] - band, mean[:_SHOWN] + band, alpha=0.2, lw=0)
    over_time.set(xlabel="s of held-out driving")
    against.plot(truth, mean, ".", ms=1.5)
    ends = np.quantile(truth, [0.001, 0.999])
    against.plot(ends, ends, color="0.6", lw=0.8)
    against.set(xlabel="measured change", ylabel="predicted", xlim=ends, ylim=ends)
    residual = np.clip((truth - mean) / std, -_OUTSIDE, _OUTSIDE)
    residuals.hist(residual, bins=80, density=True)
    x = np.linspace(-_OUTSIDE, _OUTSIDE, 200)
    residuals.plot(x, np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi), color="0.4")
    residuals.set(xlabel="residual, standard deviations")
    # Half widths, in standard deviations, of the normal distribution's two-sided intervals.
    half = ndtri(0.5 + 0.5 * _LEVELS)
    coverage.plot(_LEVELS, [np.mean(np.abs(residual) < width) for width in half])
    coverage.plot([0, 1], [0, 1], color="0.6", lw=0.8)
    coverage.set(xlabel="nominal coverage", ylabel="share inside")
