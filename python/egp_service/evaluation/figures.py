"""The evaluation's figures, with the `[viz]` extra."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from egp_service.evaluation import unknown_roads
from egp_service.evaluation.claims import POOLED
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE
from egp_service.evaluation.unknown_roads import BELIEF, HERE
from egp_service.quantities import MOTION_LABELS
from egp_service.simulation.report import ALARM, INK, MEMBER_COLOURS, MUTED, STYLE, save

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from egp_service.evaluation.campaign import Outcome
    from egp_service.evaluation.prediction import PredictionOutcome
    from egp_service.evaluation.scaling import StepTime
    from egp_service.evaluation.statistics import Group, Interval

_BARS: Final = (
    ("A", "A", 0),
    ("D", "D", 0),
    ("A", "D", 0),
    ("D", "A", 0),
    (POOLED, POOLED, 0),
    ("E(AD)", POOLED, 1),
    ("E(AD)", "T", 1),
    ("E(ABD)", "T", 1),
    ("E(ABCD)", "T", 1),
)
_DECADE: Final = 10.0
_NEAR: Final = 0.02  # points of lap times this close share a label


def colours(contenders: Sequence[str]) -> dict[str, str]:
    """Colours of the contenders: dark for the ensemble, grey for the oracle."""
    others = [name for name in contenders if name not in {ENSEMBLE, ORACLE}]
    return {ENSEMBLE: INK, ORACLE: MUTED} | dict(zip(others, cycle(MEMBER_COLOURS), strict=False))


def draw_risk(groups: Sequence[Group], path: Path) -> Path:
    """Draw lap times over the share of departures, for each source of the friction."""
    with plt.style.context(STYLE):
        figure, ax = plt.subplots(figsize=(8.0, 4.6))
        kinds = dict.fromkeys(unknown_roads.kind(g.contender) for g in groups)
        for name, colour in zip(kinds, (MUTED, INK, *MEMBER_COLOURS), strict=False):
            own = [
                g
                for g in groups
                if unknown_roads.kind(g.contender) == name and np.isfinite(g.time_regret.value)
            ]
            own.sort(key=lambda g: g.time_regret.value)
            lost = [100.0 * (g.avoidable + g.too_fast) / g.runs for g in own]
            time = [g.time_regret.value for g in own]
            ax.plot(time, lost, "o-", color=colour, label=_with_missing(name, groups))
            # The sources' curves are close: labels are above on the right, below on the right, or
            # below on the left.
            contenders = [g.contender for g in own]
            left = any(contender.startswith(BELIEF) for contender in contenders)
            below = left or any(contender.startswith(HERE) for contender in contenders)
            labels: dict[tuple[float, float], list[str]] = {}
            for g, x, y in zip(own, time, lost, strict=True):
                if g.contender != ORACLE:
                    # Of two points in one place the first has both labels.
                    near = (p for p in labels if abs(p[0] - x) < _NEAR and p[1] == y)
                    labels.setdefault(next(near, (x, y)), []).append(
                        unknown_roads.label(g.contender)
                    )
            for (x, y), names in labels.items():
                ax.annotate(
                    ";\n".join(names),
                    (x, y),
                    (-3 if left else 3, -3 if below else 3),
                    textcoords="offset points",
                    rotation=-40 if below and not left else 40,
                    rotation_mode="anchor",
                    horizontalalignment="right" if left else "left",
                    verticalalignment="top" if below else "bottom",
                    fontsize=7,
                    color=colour,
                )
        ax.set(xlabel="lap time / that of a reference that is told all zones")
        ax.set(ylabel="departures [%]", title="First lap on roads of unknown friction")
        # A scale that also fits few runs, with space for the labels.
        highest = max(10.0, ax.get_ylim()[1])
        ax.set_ylim(-0.35 * highest, 1.2 * highest)
        ax.set_yticks([tick for tick in ax.get_yticks() if 0.0 <= tick <= highest])
        _legend_beside(ax)
        return save(figure, path)


def _with_missing(source: str, groups: Sequence[Group]) -> str:
    """Name a source for the legend, with its contenders that have no time and so no point."""
    missing = [
        unknown_roads.label(g.contender)
        for g in groups
        if unknown_roads.kind(g.contender) == source and not np.isfinite(g.time_regret.value)
    ]
    return f"{source}\n(no time: {', '.join(missing)})" if missing else source


def draw_prediction(outcomes: Sequence[PredictionOutcome], path: Path) -> Path:
    """Draw RMS errors as in the paper's bar chart, and the coverage of both variances."""
    with plt.style.context(STYLE):
        figure, axes = plt.subplots(2, 3, figsize=(11.0, 6.0), sharex=True)
        labels = [f"{predictor}\non {on}" for predictor, on, _ in _BARS]
        for bar, name in enumerate(_BARS):
            rows = [o for o in outcomes if (o.predictor, o.tested_on, o.window) == name]
            shade = INK if name[0].startswith("E") else MEMBER_COLOURS[0]
            for column in range(3):
                rmse = np.array([o.rmse[column] for o in rows])
                axes[0, column].bar(bar, rmse.mean(), color=shade, width=0.7)
                axes[0, column].plot([bar, bar], [rmse.min(), rmse.max()], color=ALARM, lw=1.2)
                for offset, values, marker in (
                    (-0.12, [o.coverage[column] for o in rows], "o"),
                    (0.12, [o.coverage_mixture[column] for o in rows], "s"),
                ):
                    axes[1, column].plot(
                        bar + offset,
                        np.mean(values),
                        marker,
                        color=shade,
                        ms=4,
                        mfc="none" if marker == "s" else shade,
                    )
        for column, label in enumerate(MOTION_LABELS):
            axes[0, column].set_title(f"Δ{label}")
            axes[1, column].axhline(0.95, color=MUTED, lw=0.8)
            axes[1, column].set_xticks(range(len(labels)), labels, fontsize=6.5, rotation=60)
        axes[0, 0].set_ylabel("RMS error (line: seeds)")
        axes[1, 0].set_ylabel("inside 95 % interval\n● eq. (3)  □ mixture")
        return save(figure, path)


def draw_completion(groups: Sequence[Group], path: Path) -> Path:
    """Draw completed runs and lateral errors of each contender at each condition."""
    conditions = list(dict.fromkeys(g.condition for g in groups))
    names = list(dict.fromkeys(g.contender for g in groups))
    with plt.style.context(STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(11.0, 2.0 + 0.32 * len(names)), sharey=True)
        for group in groups:
            row, column = names.index(group.contender), conditions.index(group.condition)
            spread = 0.0 if len(conditions) == 1 else 0.7
            y = row + spread * (column / max(1, len(conditions) - 1) - 0.5)
            tone = plt.get_cmap("viridis")(0.85 * column / max(1, len(conditions) - 1))
            for ax, interval in zip(axes, (group.share, group.lateral_rms), strict=True):
                ax.plot([interval.low, interval.high], [y, y], color=tone, lw=1.2)
                ax.plot(
                    interval.value,
                    y,
                    "o",
                    ms=4,
                    color=tone,
                    label=group.condition if row == 0 else None,
                )
        axes[0].set_yticks(range(len(names)), names)
        axes[0].invert_yaxis()
        axes[0].set_title("completed runs (95 % interval)")
        axes[0].set_xlim(-0.03, 1.03)
        axes[1].set_title("lateral RMS error, m (median, 95 % interval)")
        if any(group.lateral_rms.value > 0.0 for group in groups):
            axes[1].set_xscale("log")
            axes[1].set_xlabel("logarithmic")
            low, high = axes[1].get_xlim()
            wide = high > _DECADE * low
            steps = (1.0, 2.0, 5.0) if wide else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
            axes[1].xaxis.set_major_locator(LogLocator(subs=steps))
        axes[1].xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes[1].xaxis.set_minor_formatter(NullFormatter())
        _legend_beside(axes[1])
        return save(figure, path)


def draw_entry_speeds(medians: Mapping[tuple[str, str], Interval], path: Path) -> Path:
    """Draw the highest entry speeds with their intervals, by `(contender, surface)`."""
    surfaces = list(dict.fromkeys(surface for _, surface in medians))
    names = list(dict.fromkeys(contender for contender, _ in medians))
    colour = colours(names)
    with plt.style.context(STYLE):
        figure, ax = plt.subplots(figsize=(8.0, 1.2 + 0.7 * len(surfaces)))
        for (name, surface), found in medians.items():
            spread = 0.7 * (names.index(name) / max(1, len(names) - 1) - 0.5)
            y = surfaces.index(surface) + spread
            ax.plot([found.low, found.high], [y, y], color=colour[name], lw=1.2)
            label = name if surface == surfaces[0] else None
            ax.plot(found.value, y, "o", ms=4, color=colour[name], label=label)
        ax.set_yticks(range(len(surfaces)), surfaces)
        ax.invert_yaxis()
        ax.set_xlabel("highest entry speed, m/s")
        _legend_beside(ax)
        return save(figure, path)


def draw_settling(outcomes: Sequence[Outcome], path: Path) -> Path:
    """Draw the distribution of settling times by lateral acceleration."""
    runs = [o for o in outcomes if o.experiment == "friction-step"]
    conditions = list(dict.fromkeys(o.condition for o in runs))
    names = list(dict.fromkeys(o.contender for o in runs))
    colour = colours(names)
    with plt.style.context(STYLE):
        figure, ax = plt.subplots(figsize=(9.0, 3.4))
        for number, name in enumerate(names):
            for place, condition in enumerate(conditions):
                own = [o for o in runs if (o.contender, o.condition) == (name, condition)]
                times = [time for o in own for time in o.settling]
                x = place + 0.42 * (number - 0.5 * (len(names) - 1))
                ax.plot(np.full(len(times), x), times, ".", color=colour[name], alpha=0.5)
                if times:
                    ax.plot(x, np.median(times), "_", ms=18, color=colour[name])
                moved = sum(bool(o.settling) for o in own)
                count = f"{moved}/{len(own)}"
                ax.text(x, -0.14, count, ha="center", fontsize=7, color=colour[name])
        for name in names:
            ax.plot([], [], "o", color=colour[name], label=name)
        ax.axhline(0.5, color=ALARM, lw=0.8)
        labels = [condition.replace(" lateral", "").replace(", ", "\n") for condition in conditions]
        ax.set_xticks(range(len(conditions)), labels)
        ax.set_xlabel("lateral acceleration")
        ax.set_xlim(-0.5, len(conditions) - 0.5)
        ax.set_ylim(-0.25, 2.1)
        ax.set_title(
            "Below: runs in which the weights moved, of all. At 2 s: not settled within 2 s"
        )
        ax.set_ylabel("settling time, s")
        _legend_beside(ax)
        return save(figure, path)


def draw_scaling(times: Sequence[StepTime], path: Path) -> Path:
    """Draw the step time over the number of members."""
    with plt.style.context(STYLE):
        figure, ax = plt.subplots(figsize=(6.0, 3.4))
        for name in dict.fromkeys(t.program for t in times):
            rows = [t for t in times if t.program == name]
            members = [t.members for t in rows]
            ax.plot(members, [t.p50_ms for t in rows], "o-", label=name)
            ax.fill_between(members, [t.p50_ms for t in rows], [t.p95_ms for t in rows], alpha=0.2)
        ax.set_xscale("log", base=2)
        ax.set_yscale("log")
        ax.set_xlabel("members")
        ax.set_ylabel("time of a control step, ms")
        _legend_beside(ax)
        return save(figure, path)


def _legend_beside(ax: Axes) -> None:
    """Place the legend to the right of the plot, where no curve is."""
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
