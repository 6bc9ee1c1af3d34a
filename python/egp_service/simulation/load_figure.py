"""Picture of a load test with recorded requests; requires the `[viz]` extra."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from matplotlib import pyplot as plt

from egp_service.simulation.report import ALARM, FOUND, INK, MEMBER_COLOURS, MUTED, STYLE, save

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from matplotlib.axes import Axes

_QUANTILES = (("p50", "median", INK), ("p99", "99 %", FOUND), ("p999", "99.9 %", MEMBER_COLOURS[1]))


def draw_load(report_file: Path, path: Path) -> None:
    """Draw the share of requests in time and quantiles of the latency over the offered load.

    `report_file` is the JSON of `egp load --replay`. The knee, the most vehicles that held the
    fraction of `--ramp`, is a vertical line if a rate beyond it was measured. Latencies in ms count
    from when a request was due. A triangle above a rate says that the quantiles which are not drawn
    there fall on requests without a reply or on refused ones.
    """
    report = json.loads(report_file.read_text(encoding="utf-8"))
    with plt.style.context(STYLE):
        figure, (share, latency) = plt.subplots(2, 1, sharex=True, figsize=(7.0, 5.6))
        _share(share, report)
        _latency(latency, report)
        title, knee = _knee(report)
        share.set_title(title)
        if knee is not None:
            for ax in (share, latency):
                ax.axvline(knee, color=MUTED, linewidth=0.9, linestyle="--")
        save(figure, path)


def _knee(report: Mapping[str, Any]) -> tuple[str, float | None]:
    """Say what was found, and return the requests a second at the knee if it was."""
    if report["hold"] is None:
        return "One rate was measured", None
    held = [r for r in report["rates"] if r["vehicles"] <= (report["knee_vehicles"] or 0)]
    if not held:
        return "No rate held: the knee is below the first one", None
    vehicles, offered = held[-1]["vehicles"], held[-1]["requests_per_second"]
    if len(held) == len(report["rates"]):
        return f"Every rate held: the knee is beyond {vehicles} vehicles", None
    return f"Knee: {vehicles} vehicles, {offered:.0f} requests a second", offered


def _share(ax: Axes, report: Mapping[str, Any]) -> None:
    rates = report["rates"]
    offered = [rate["requests_per_second"] for rate in rates]
    for field, label, colour, style in (
        ("in_deadline_fraction", "all vehicles", INK, "o-"),
        ("least_vehicle_fraction", "the vehicle with the fewest", FOUND, "s--"),
    ):
        percent = [100.0 * rate[field] for rate in rates]
        ax.plot(offered, percent, style, color=colour, label=label, ms=4)
    if report["hold"] is not None:
        ax.axhline(100.0 * report["hold"], color=ALARM, linewidth=0.9)
        ax.text(offered[0], 100.0 * report["hold"] - 6.0, "demanded", color=ALARM)
    ax.set(ylabel="in time [%]", ylim=(0.0, 104.0))
    ax.legend(loc="lower left")


def _latency(ax: Axes, report: Mapping[str, Any]) -> None:
    rates = report["rates"]
    offered = [rate["requests_per_second"] for rate in rates]
    for field, label, colour in _QUANTILES:
        times = [rate["latency_ms"][field] for rate in rates]
        ax.plot(offered, times, "o-", color=colour, label=label, ms=4)
    lag = [rate["generator_lag_ms"]["p99"] for rate in rates]
    ax.plot(offered, lag, "s--", color=MUTED, label="generator's lag, 99 %", ms=4)
    ends = [r["requests_per_second"] for r in rates if r["latency_ms"][_QUANTILES[-1][0]] is None]
    if ends:
        above, edge = [1.03] * len(ends), ax.get_xaxis_transform()  # in heights of the axes
        (triangles,) = ax.plot(ends, above, "^", color=ALARM, transform=edge, ms=5, clip_on=False)
        triangles.set_label("others: no reply, or refused")
    period = 1e3 * report["period_s"]
    ax.axhline(period, color=ALARM, linewidth=0.9)
    ax.text(offered[0], 1.1 * period, "control period", color=ALARM)
    ax.set(xlabel="offered requests a second", ylabel="latency [ms]", yscale="log")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
