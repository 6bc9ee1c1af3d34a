"""Pictures of a run; requires the `[viz]` extra."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Final

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from egp_service._core import GRAVITY, EgpError
from egp_service.files import replacing
from egp_service.quantities import OMEGA, POSITION, V_X, V_Y

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path as FilePath

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from egp_service._core import Path
    from egp_service.simulation.closed_loop import Run

STYLE = {
    "figure.dpi": 150,
    "figure.constrained_layout.use": True,
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a8f98",
    "axes.labelcolor": "#30343b",
    "axes.titlelocation": "left",
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlecolor": "#1f2937",
    "xtick.color": "#5a606b",
    "ytick.color": "#5a606b",
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "savefig.facecolor": "white",
}
INK, MUTED, ALARM = "#1f2937", "#8a8f98", "#c2410c"
_CHARACTERS: Final = 10.0  # of a title in an inch
FOUND, PLANNED = "#4ba3c7", "#6a994e"
MEMBER_COLOURS = ("#4ba3c7", "#e0a13a", "#6a994e", "#9d6bb0", "#c8553d", "#5c677d")
# From ice to dry asphalt.
SURFACE = LinearSegmentedColormap.from_list("surface", ["#cfe6f5", "#b9c2c9", "#82878d"])
FRICTION_RANGE = Normalize(0.4, 1.2)
SPEED = mpl.colormaps["plasma"]
# Points on white need darker colours than areas.
FRICTION_POINTS = LinearSegmentedColormap.from_list("points", ["#3b8fc4", "#6a994e", "#2b2d33"])


def check_picture(path: FilePath) -> None:
    """Raise `EgpError` unless a picture can have this name, which tells its format."""
    if path.is_dir():
        raise EgpError(f"{path} is a folder: name a picture in it, such as {path / 'picture.png'}")
    known = FigureCanvasBase.get_supported_filetypes()
    if path.suffix.removeprefix(".").lower() not in known:
        raise EgpError(
            f"{path} does not name a picture: its ending is '{path.suffix}'; use .png, .svg or .pdf"
        )


def save(figure: Figure, path: FilePath) -> FilePath:
    """Write a figure within the context of `STYLE`, close it, and return its path."""
    with replacing(path) as beside:
        figure.savefig(beside)
    plt.close(figure)
    return path


PICTURES: Final = ("track.png", "weights.png", "errors.png", "commands.png", "step-times.png")
"""Names of the pictures of a run."""


def draw_run(run: Run, folder: FilePath) -> list[FilePath]:
    """Draw all pictures of a run into `folder`; return their paths."""
    figures = (
        _track_figure,
        _weights_figure,
        _errors_figure,
        _commands_figure,
        _step_times_figure,
    )
    return [
        _save(figure, run, folder / name) for figure, name in zip(figures, PICTURES, strict=True)
    ]


def draw_weights(run: Run, path: FilePath, title: str | None = None) -> FilePath:
    """Draw weights, the friction (true, found and planned for), and the grip used in corners."""
    return _save(_weights_figure, run, path, title)


def draw_errors(run: Run, path: FilePath, title: str | None = None) -> FilePath:
    """Draw lateral and heading errors, and the speed with its reference."""
    return _save(_errors_figure, run, path, title)


def draw_comparison(runs: Sequence[tuple[str, Run]], path: FilePath) -> FilePath:
    """Draw the tracks of several runs of a scenario side by side, and their errors in one plot."""
    with plt.style.context(STYLE):
        return save(_comparison_figure(runs), path)


def _comparison_figure(runs: Sequence[tuple[str, Run]]) -> Figure:
    figure = plt.figure(figsize=(min(4.2 * len(runs), 12.5), 5.4))
    rows = figure.add_gridspec(2, len(runs), height_ratios=(1.25, 1.0))
    driven = np.concatenate([run.trace.x[:, V_X] for _, run in runs])
    speeds = Normalize(float(driven.min()), float(driven.max()))
    axes = [figure.add_subplot(rows[0, column]) for column in range(len(runs))]
    for ax, (label, run) in zip(axes, runs, strict=True):
        lines = draw_track(ax, run, speeds)
        ending = run.summary.ending
        verdict = (
            f"{run.summary.lateral_error.max:.2f} m beside the path"
            if ending.completed
            else ending.reason.split(":")[0]
        )
        title = f"{label}\n{fill(verdict, round(_CHARACTERS * figure.get_figwidth() / len(runs)))}"
        ax.set_title(title, color=INK if ending.completed else ALARM, pad=12.0)
    figure.colorbar(lines, ax=axes, label="speed [m/s]", shrink=0.7, aspect=20)
    ax = figure.add_subplot(rows[1, :])
    draw_zones(ax, runs[0][1].path, max(float(run.trace.distance[-1]) for _, run in runs))
    for index, (label, run) in enumerate(runs):
        colour = INK if index == 0 else MEMBER_COLOURS[(index - 1) % len(MEMBER_COLOURS)]
        ax.plot(run.trace.distance, run.trace.lateral_error, color=colour, label=label)
        if not run.summary.ending.completed:
            ax.plot(run.trace.distance[-1], run.trace.lateral_error[-1], "X", color=ALARM)
    ax.axhline(0.0, color=MUTED, linewidth=0.6)
    ax.set(xlabel="distance [m]", ylabel="beside the path [m]", title="Lateral error")
    _legend_above(ax, len(runs))
    return figure


_SHORTEST: Final = 1.0
"""Least length of a plot over distance, m."""
# A label is centred on a direction that is at most this much of the unit vector towards it.
_BESIDE: Final = 0.4
_BAR_BELOW: Final = -20.0  # points, from the place of the lowest label to the bar of the scale


def draw_track(ax: Axes, run: Run, speeds: Normalize | None = None) -> LineCollection:
    """Draw the road coloured by friction, the reference dashed and the driven line by speed."""
    path, trace = run.path, run.trace
    s = np.linspace(0.0, path.length, max(200, int(path.length)))
    x, y, yaw, _, left, right, friction = path.sample(s)
    normal = np.column_stack([-np.sin(yaw), np.cos(yaw)])
    centre = np.column_stack([x, y])
    lefts = centre + normal * np.where(np.isfinite(left), left, 2.0)[:, None]
    rights = centre - normal * np.where(np.isfinite(right), right, 2.0)[:, None]
    quads = np.stack([lefts[:-1], lefts[1:], rights[1:], rights[:-1]], axis=1)
    road = PolyCollection(list(quads), edgecolors="face", linewidths=0.4)
    road.set(array=friction[:-1], cmap=SURFACE, norm=FRICTION_RANGE, snap=False)
    ax.add_collection(road)
    ax.plot(x, y, color="white", linewidth=0.7, linestyle=(0, (6, 6)))
    points = trace.x[:, POSITION]
    lines = LineCollection(
        list(np.stack([points[:-1], points[1:]], axis=1)),
        array=trace.x[:-1, V_X],
        cmap=SPEED,
        norm=speeds,
        linewidths=2.0,
        capstyle="round",
    )
    ax.add_collection(lines)
    ax.plot(*points[0], marker="o", color="white", markeredgecolor=INK, markersize=6)
    if not run.summary.ending.completed:
        ax.plot(*run.summary.ending.position, marker="X", color=ALARM, markersize=9)
    labels = []
    for start, end, mu in _zones(path, path.length):
        p_x, p_y, angle, _, _, reach, _ = (
            column[0] for column in path.sample(np.array([0.5 * (start + end)]))
        )
        offset = (reach if np.isfinite(reach) else 2.0) + 0.015 * path.length
        labels.append((p_x + np.sin(angle) * offset, p_y - np.cos(angle) * offset))
        # The text continues away from the road.
        across, up = np.sin(angle), -np.cos(angle)
        ax.text(
            *labels[-1],
            f"μ {mu:g}",
            ha="center" if abs(across) < _BESIDE else "left" if across > 0.0 else "right",
            va="center" if abs(up) < _BESIDE else "bottom" if up > 0.0 else "top",
            color="#5a606b",
        )
    edges = np.vstack([lefts, rights])
    ax.update_datalim([*labels, *_draw_direction(ax, edges, run)])
    _draw_scale(ax, edges, min(float(edges[:, 1].min()), *(y for _, y in labels)))
    ax.margins(0.04)
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.axis("off")
    return lines


def _draw_scale(ax: Axes, edges: NDArray[np.float64], lowest: float) -> None:
    """Draw a bar of a round length below `lowest`, which is the height of the lowest label."""
    left, extent = float(edges[:, 0].min()), float(np.ptp(edges, axis=0).max())
    decade = 10.0 ** np.floor(np.log10(0.25 * extent))
    bar = decade * max(step for step in (1.0, 2.0, 5.0) if step * decade <= 0.25 * extent)
    # Below the text of a label, whose height does not depend on the track's.
    below = ax.transData + ScaledTranslation(0.0, _BAR_BELOW / 72.0, ax.figure.dpi_scale_trans)
    ends = ([left, left + bar], [lowest, lowest])
    ax.add_artist(Line2D(*ends, transform=below, color=INK, linewidth=1.6, clip_on=False))
    ax.text(left + bar, lowest, f"  {bar:g} m", transform=below, va="center", color=INK)


def _draw_direction(ax: Axes, edges: NDArray[np.float64], run: Run) -> list[tuple[float, float]]:
    """Draw an arrow beside the start, and return its ends."""
    extent = float(np.ptp(edges, axis=0).max())
    p_x, p_y, yaw, _, left, *_ = (column[0] for column in run.path.sample(np.zeros(1)))
    beside = (left if np.isfinite(left) else 2.0) + 0.04 * extent
    tail = np.array([p_x - np.sin(yaw) * beside, p_y + np.cos(yaw) * beside])
    head = tail + 0.12 * extent * np.array([np.cos(yaw), np.sin(yaw)])
    ax.annotate("", tuple(head), tuple(tail), arrowprops={"arrowstyle": "->", "color": INK})
    return [tuple(head.tolist()), tuple(tail.tolist())]


def _legend_above(ax: Axes, columns: int) -> None:
    """Place the legend above the plot, at its right end, where no curve is."""
    ax.legend(ncols=columns, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)


def draw_zones(ax: Axes, path: Path, distance: float) -> None:
    """Draw surfaces as bands behind a plot over distance.

    A run may end at its start or behind it; the plot then covers the first metre.
    """
    distance = max(distance, _SHORTEST)
    for start, end, mu in _zones(path, distance):
        ax.axvspan(start, end, color=SURFACE(FRICTION_RANGE(mu)), alpha=0.45, linewidth=0)
    ax.set_xlim(0.0, distance)


def _track_figure(run: Run) -> Figure:
    figure, ax = plt.subplots(figsize=(8.0, 5.2))
    lines = draw_track(ax, run)
    figure.colorbar(lines, ax=ax, label="speed [m/s]", shrink=0.75, aspect=30)
    ending = run.summary.ending
    how = "completed" if ending.completed else ending.reason
    ax.set_title(
        f"{run.scenario.name}: {how} in {ending.time:.1f} s\n"
        f"at most {run.summary.lateral_error.max:.2f} m beside the path, "
        f"{run.summary.lateral_error.rms:.2f} m RMS",
        color=INK if ending.completed else ALARM,
    )
    return figure


def _weights_figure(run: Run) -> Figure:
    figure, (top, middle, bottom) = plt.subplots(
        3, 1, figsize=(8.0, 6.0), sharex=True, height_ratios=(1.4, 1.0, 0.5)
    )
    trace = run.trace
    known = np.isfinite(trace.weights[:, 0])
    distance, weights = trace.distance[known], trace.weights[known]
    colours = [MEMBER_COLOURS[i % len(MEMBER_COLOURS)] for i in range(len(run.members))]
    top.stackplot(distance, weights.T, labels=run.members, colors=colours, alpha=0.9, linewidth=0)
    top.set(ylim=(0.0, 1.0), ylabel="weight", title="Weights of the members")
    _legend_above(top, len(run.members))
    for ax in (middle, bottom):
        draw_zones(ax, run.path, float(trace.distance[-1]))
    middle.step(trace.distance, trace.friction, color=INK, where="post", label="true friction")
    lower, upper = trace.friction_found.T
    middle.fill_between(
        trace.distance, lower, upper, color=FOUND, alpha=0.35, linewidth=0, label="found, 90 %"
    )
    # A service may have another library than the scenario, whose members' frictions are not known.
    if len(run.frictions) == weights.shape[1]:
        middle.plot(distance, weights @ run.frictions, color=ALARM, label="the members', weighted")
    if run.scenario.speed.knows != "zones":
        middle.plot(trace.distance, trace.friction_planned, color=PLANNED, label="planned for")
    middle.set(ylabel="μ", ylim=(0.0, max(1.4, middle.get_ylim()[1])))
    _legend_above(middle, 4)
    grip = np.abs(trace.x[:, V_X] * trace.x[:, OMEGA]) / (GRAVITY * trace.friction)
    bottom.fill_between(trace.distance, grip, color=MUTED, linewidth=0)
    bottom.set(xlabel="distance [m]", ylabel="grip used\nin corners")
    bottom.set_ylim(0.0, max(1.0, bottom.get_ylim()[1]))
    bottom.set_title("Surfaces are distinguishable only where grip is used", weight="normal")
    return figure


def _errors_figure(run: Run) -> Figure:
    figure, (lateral, heading, speed) = plt.subplots(3, 1, figsize=(8.0, 6.4), sharex=True)
    trace = run.trace
    for ax in (lateral, heading, speed):
        draw_zones(ax, run.path, float(trace.distance[-1]))
    for ax in (lateral, heading):
        ax.axhline(0.0, color=MUTED, linewidth=0.6)
    lateral.plot(trace.distance, trace.lateral_error, color=INK)
    lateral.set(ylabel="beside the path [m]", title="Tracking errors over the surfaces")
    heading.plot(trace.distance, np.rad2deg(trace.heading_error), color=INK)
    heading.set(ylabel="heading error [°]")
    reference = trace.x[:, V_X] - trace.speed_error
    speed.plot(trace.distance, reference, color=MUTED, linestyle="--", label="reference")
    speed.plot(trace.distance, trace.x[:, V_X], color=INK, label="driven")
    speed.set(ylabel="speed [m/s]", xlabel="distance [m]")
    _legend_above(speed, 2)
    return figure


def _commands_figure(run: Run) -> Figure:
    """Commands over the distance, and accelerations over each other (g-g diagram)."""
    figure, axes = plt.subplot_mosaic(
        [["force", "g-g"], ["rate", "g-g"]], figsize=(11.0, 4.6), width_ratios=(1.4, 1.0)
    )
    trace, force, rate, diagram = run.trace, axes["force"], axes["rate"], axes["g-g"]
    for ax, column, scale, label in (
        (force, 0, 1e-3, "force [kN]"),
        (rate, 1, 1.0, "steering rate [rad/s]"),
    ):
        draw_zones(ax, run.path, float(trace.distance[-1]))
        ax.axhline(0.0, color=MUTED, linewidth=0.6)
        ax.plot(trace.distance, scale * trace.u[:, column], color=INK, linewidth=0.9)
        ax.set(ylabel=label)
    force.set(title="Commands")
    rate.set(xlabel="distance [m]")
    v_x, v_y, omega = trace.x[:-1, [V_X, V_Y, OMEGA]].T
    changes = np.diff(trace.x[:, [V_X, V_Y]], axis=0) / run.dt
    along, across = (changes + np.column_stack([-v_y, v_x]) * omega[:, None]).T / GRAVITY
    diagram.scatter(
        across, along, c=trace.friction[:-1], s=3, cmap=FRICTION_POINTS, norm=FRICTION_RANGE
    )
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    for mu in np.unique(trace.friction):
        colour = FRICTION_POINTS(FRICTION_RANGE(mu))
        label = f"µ g at {mu:g}"
        diagram.plot(mu * np.sin(angle), mu * np.cos(angle), color=colour, lw=0.9, label=label)
    diagram.set(xlabel="to the left [g]", ylabel="forwards [g]", aspect="equal")
    diagram.locator_params(nbins=5, steps=[1, 2, 5, 10])
    diagram.set_title("Accelerations")
    diagram.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _step_times_figure(run: Run) -> Figure:
    figure, ax = plt.subplots(figsize=(8.0, 3.2))
    milliseconds, deadline = 1e3 * run.trace.step_time, 1e3 * run.deadline
    low = 0.8 * float(np.min(milliseconds))
    high = 1.25 * max(deadline, float(np.max(milliseconds)))
    ax.hist(milliseconds, bins=list(np.geomspace(low, high, 60)), color=MEMBER_COLOURS[0])
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    for value, name, colour in (
        (run.summary.step_time_ms["p50"], "median", INK),
        (run.summary.step_time_ms["p99"], "p99", INK),
        (deadline, "deadline", ALARM),
    ):
        ax.axvline(
            value, color=colour, linewidth=1.0, linestyle="-" if name == "deadline" else "--"
        )
        ax.annotate(
            f"{name} {value:.3g} ms",
            (value, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(3, -2),
            textcoords="offset points",
            va="top",
            rotation=90,
            color=colour,
            fontsize=8,
            # The median's label is in front of the bars.
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        )
    ax.set(xlabel="request to command [ms]", ylabel="periods", title="Time of a control step")
    return figure


def _zones(path: Path, distance: float) -> list[tuple[float, float, float]]:
    """Return stretches (start, end, mu) of constant friction up to `distance`, over all laps."""
    s = np.arange(0.0, distance, 0.25)
    friction: NDArray[np.float64] = path.sample(s % path.length if path.closed else s)[-1]
    borders = np.flatnonzero(np.diff(friction)) + 1
    starts = [0, *borders.tolist()]
    ends = [*(s[borders].tolist()), distance]
    return [(float(s[i]), end, float(friction[i])) for i, end in zip(starts, ends, strict=True)]


def _save(
    draw: Callable[[Run], Figure], run: Run, path: FilePath, title: str | None = None
) -> FilePath:
    with plt.style.context(STYLE):
        figure = draw(run)
        if title:
            figure.suptitle(title, x=0.01, ha="left")
        return save(figure, path)
