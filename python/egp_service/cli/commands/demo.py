"""`egp demo`."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from egp_service.cli.options import NOT_COMPLETED, RunsFolder
from egp_service.cli.output import say

if TYPE_CHECKING:
    from egp_service.cli.demo import Lap


def demo(
    *,
    train: Annotated[
        bool,
        typer.Option(
            "--train",
            help="Collect data and train a library first, instead of using the "
            "shipped one. This takes minutes and requires the extra train.",
        ),
    ] = False,
    output: RunsFolder = Path("runs"),
) -> None:
    """Drive laps over three surfaces of unknown friction.

    The control steps find the friction, and each lap is planned with what the
    laps before found. Then the same lap is driven with a reference speed that
    is planned for the true friction of all zones: with the library's ensemble,
    and with each of its two members alone. A service in its own process
    computes every control step. The exit status is 3 if the ensemble did not
    complete a lap.

    For example: egp demo
    """
    from egp_service.cli.demo import LAPS, drive_laps
    from egp_service.cli.signals import naming_folder
    from egp_service.cli.status_line import StatusLine
    from egp_service.cli.tables import summary_table
    from egp_service.simulation.report import draw_comparison, draw_run
    from egp_service.simulation.runs import new_folder

    console = Console()
    start = time.perf_counter()
    folder = new_folder(output, "demo")
    library = _trained(folder) if train else None
    with naming_folder(console, folder):
        with StatusLine(console) as line:
            laps = drive_laps(library, folder, line.show)
        console.print(summary_table([(lap.label, lap.run.summary) for lap in laps]))
        with console.status("Drawing ..."):
            overview = draw_comparison(
                [(lap.label, lap.run) for lap in laps if lap.label != LAPS[1]], folder / "laps.png"
            )
            for lap in laps:
                draw_run(lap.run, lap.folder)
    _explain(console, laps)
    pictures = (overview, laps[0].folder / "weights.png", folder)
    say(
        console,
        f"Took {time.perf_counter() - start:.0f} s. Look at:",
        *(f"  {path}" for path in pictures),
    )
    if not all(lap.run.summary.ending.completed for lap in laps if not lap.alone):
        raise typer.Exit(NOT_COMPLETED)


def _trained(folder: Path) -> Path:
    from egp_service.cli.commands import train
    from egp_service.shipped import DEMO_RECIPE

    library = folder / "library.safetensors"
    train.train(library, recipe=DEMO_RECIPE)
    return library


def _explain(console: Console, laps: "list[Lap]") -> None:
    """Print a sentence about the table."""
    from egp_service.cli.demo import LAPS, TOLD

    runs = {lap.label: lap.run.summary for lap in laps}
    lost = [lap.label for lap in laps if not lap.run.summary.ending.completed]
    if lost:
        console.print(f"[red]Not completed: {', '.join(lost)}.[/]")
    if any(lap.label in lost for lap in laps if not lap.alone):
        return
    first, last, told = (runs[label].ending.time for label in (LAPS[0], LAPS[-1], TOLD))
    console.print(
        f"The first lap, planned for the estimated friction, takes {first / told:.2f} times as "
        f"long as the lap planned for the true friction, and the third {last / told:.2f} times."
    )
    alone = [lap.run.summary.lateral_error.max for lap in laps if lap.alone]
    console.print(
        f"Planned for the true friction, laps stay within {runs[TOLD].lateral_error.max:.2f} m of "
        f"the path with the ensemble, and are up to {max(alone):.2f} m beside it with one member."
    )
