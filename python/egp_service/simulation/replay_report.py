"""Picture of a replay that differs from its recording; requires the `[viz]` extra."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib import pyplot as plt

from egp_service.control.replay import MATTERS
from egp_service.quantities import F_X, POSITION
from egp_service.simulation.report import ALARM, INK, MUTED, STYLE, save

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from egp_service.control.replay import Replay


def draw_replay(replay: Replay, change: str, path: Path) -> None:
    """Draw recorded and replayed commands over time, their difference, and where it matters."""
    with plt.style.context(STYLE):
        figure = plt.figure(figsize=(11.0, 6.4))
        grid = figure.add_gridspec(3, 2, width_ratios=(1.7, 1.0))
        force = figure.add_subplot(grid[0, 0])
        rate = figure.add_subplot(grid[1, 0], sharex=force)
        share = figure.add_subplot(grid[2, 0], sharex=force)
        _commands(force, rate, replay)
        _difference(share, replay)
        _track(figure.add_subplot(grid[:2, 1]), replay)
        first = replay.first_that_matters
        for ax in (force, rate, share):
            if first is not None:
                ax.axvline(replay.time[first], color=ALARM, linewidth=0.9, linestyle="--")
        figure.suptitle(f"Replay with {change}", x=0.01, ha="left")
        save(figure, path)


def _commands(force: Axes, rate: Axes, replay: Replay) -> None:
    for ax, column, scale in ((force, F_X, 1e-3), (rate, 1, 1.0)):
        ax.plot(replay.time, scale * replay.u_recorded[:, column], color=MUTED, label="recorded")
        ax.plot(replay.time, scale * replay.u_now[:, column], color=INK, lw=1.0, label="replayed")
        ax.tick_params(labelbottom=False)
    force.set(ylabel="force [kN]", title="First input of each plan")
    force.legend(loc="lower left", bbox_to_anchor=(0.55, 1.0), ncols=2, borderaxespad=0.2)
    rate.set(ylabel="steering rate [rad/s]")


def _difference(ax: Axes, replay: Replay) -> None:
    finite = np.isfinite(replay.share)
    percent = 100.0 * np.where(finite, replay.share, np.nan)
    ax.plot(replay.time, percent, color=INK)
    ax.axhline(100.0 * MATTERS, color=ALARM, linewidth=0.9)
    if not finite.all():
        ax.plot(replay.time[~finite], np.zeros((~finite).sum()), "X", color=ALARM, markersize=5)
    ax.set_yscale("symlog", linthresh=100.0 * MATTERS)
    ax.yaxis.set_major_formatter("{x:g}")
    ax.set_ylim(bottom=0.0)
    ax.set(xlabel="time [s]", ylabel="% of the range")
    ax.set_title(f"Difference of the commands; above {100 * MATTERS:g} % it matters")


def _track(ax: Axes, replay: Replay) -> None:
    points = replay.x[:, POSITION]
    ax.plot(*points.T, color=MUTED, linewidth=1.0)
    matters = points[replay.share > MATTERS]
    if len(matters):
        ax.plot(*matters.T, ".", color=ALARM, markersize=4, label="the command differs")
        ax.plot(*matters[0], "o", color="white", markeredgecolor=ALARM, markersize=8, label="first")
    ax.set_aspect("equal")
    ax.margins(0.06)
    ax.set(xlabel="x [m]", ylabel="y [m]", title="Where it matters")
    if len(matters):
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.24), ncols=2)
