"""Tables for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich import box
from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from egp_service.summary import Summary


def summary_table(rows: Sequence[tuple[str, Summary]]) -> Table:
    """Return a table with a row for each run: result, errors and times."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("run", no_wrap=True)
    table.add_column("result")
    for header in (
        "time\ns",
        "beside path, m\nmax / RMS",
        "speed, m/s\nmean / error",
        "step, ms\np50 / p99",
        "missed",
    ):
        table.add_column(header, justify="right", no_wrap=True)
    for label, summary in rows:
        ending = summary.ending
        result = "[green]completed[/]"
        if not ending.completed:
            result = f"[red]{ending.reason.partition(':')[0]} after {ending.distance:.0f} m[/]"
        table.add_row(
            label,
            result,
            f"{ending.time:.1f}",
            f"{summary.lateral_error.max:.2f} / {summary.lateral_error.rms:.2f}",
            f"{summary.mean_speed:.1f} / {summary.speed_error.rms:.2f}",
            f"{summary.step_time_ms['p50']:.1f} / {summary.step_time_ms['p99']:.1f}",
            f"{summary.deadline_misses}",
        )
    return table
