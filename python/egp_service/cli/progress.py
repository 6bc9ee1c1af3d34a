"""Progress bars of imports, collection, training and evaluation."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rich.console import Console

    from egp_service.training.train import FitProgress


def counting(console: Console) -> Progress:
    """Return bars that count runs, with the time so far and the remaining one."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )


def _bars(console: Console, noun: str, *, transient: bool) -> Progress:
    """Return bars that count things, with the remaining time."""
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(noun),
        TimeRemainingColumn(),
        console=console,
        transient=transient,
    )


@contextlib.contextmanager
def collecting(console: Console) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each surface; the callable takes label, completed runs and all runs."""
    with _bars(console, "runs", transient=False) as progress:
        tasks = {}

        def report(label: str, done: int, total: int) -> None:
            if label not in tasks:
                tasks[label] = progress.add_task(f"collecting {label}", total=total)
            progress.update(tasks[label], completed=done)

        yield report


@contextlib.contextmanager
def counted(console: Console, what: str, noun: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar until the work is done; the callable takes the completed things, and all."""
    with _bars(console, noun, transient=True) as progress:
        task = progress.add_task(what, total=None, visible=False)

        def report(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total, visible=True)

        yield report


@contextlib.contextmanager
def working(console: Console, what: str) -> Iterator[None]:
    """Show a bar without an end, and the time so far, around work that counts nothing."""
    with Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    ) as progress:
        progress.add_task(what, total=None)
        yield


@contextlib.contextmanager
def fitting(console: Console) -> Iterator[Callable[[FitProgress], None]]:
    """Show one bar over all fits with the present loss and the remaining time.

    The bar jumps when a fit converges early, so the remaining time is an upper bound. Before the
    first fit there is a line without a bar, which an error in the data removes.
    """
    progress = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("loss {task.fields[loss]:8.4f}"),
        TimeElapsedColumn(),
        TextColumn("at most"),
        TimeRemainingColumn(),
        console=console,
    )
    task = progress.add_task("training", total=None, loss=float("nan"))
    with contextlib.ExitStack() as shown:
        shown.enter_context(console.status("Preparing the data ..."))

        def report(step: FitProgress) -> None:
            if not progress.live.is_started:
                shown.close()
                shown.enter_context(progress)
            progress.update(
                task,
                description=step.stage,
                completed=step.done,
                total=step.total,
                loss=step.loss,
            )

        yield report
        total = progress.tasks[0].total
        progress.update(task, description="trained", completed=total or 1, total=total)
