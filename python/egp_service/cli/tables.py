"""Tables for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich import box
from rich.table import Table

from egp_service.quantities import GP_OUTPUT
from egp_service.training.validation import ROLLOUT

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from egp_service.simulation.summary import Summary
    from egp_service.training.validation import Cell


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


def validation_table(matrix: list[list[Cell]]) -> Table:
    """Return the matrix for the terminal, a row for each member, surface and output."""
    table = Table(
        "member",
        "on surface",
        "output",
        "RMSE",
        "NLPD",
        "in 95 %",
        f"after {ROLLOUT:g} s",
        title="Validation on held-out trajectories (m/s, rad/s)",
        box=box.SIMPLE_HEAD,
    )
    for row in matrix:
        for cell in row:
            names = (cell.member, cell.surface)
            for output, *values in zip(
                GP_OUTPUT, cell.rmse, cell.nlpd, cell.coverage, cell.rollout, strict=True
            ):
                rmse, nlpd, coverage, rollout = values
                table.add_row(
                    *names,
                    output,
                    f"{rmse:.4f}",
                    f"{nlpd:.2f}",
                    f"{coverage:.2f}",
                    f"{rollout:.3f}",
                    style="bold" if cell.member == cell.surface else "",
                )
                names = ("", "")
        table.add_section()
    return table


def map_summary(origins: Mapping[str, float], trust: float | None) -> str:
    """Say whose evidence about the road was used, how old it is, and whether it fits the road."""
    if not origins or trust is None:
        return "The fleet's map says nothing about this road yet"
    vehicles = ", ".join(f"{name} ({age:.0f} s ago)" for name, age in sorted(origins.items()))
    return f"The fleet's map has evidence of {vehicles}; it describes the road with {trust:.0%}"
