"""`egp demo`."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

if TYPE_CHECKING:
    from egp_service.cli.demo import Lap


def demo(
    *,
    train: Annotated[
        bool,
        typer.Option(
            "--train",
            help="Collect data and train a library first, instead of using the "
            "shipped one. This takes minutes and requires the [train] extra.",
        ),
    ] = False,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the runs.")] = Path(
        "runs"
    ),
) -> None:
    """Compare the ensemble with its single members on a lap over three surfaces.

    The library has members for two surfaces. The car drives the lap with the
    ensemble of both members and then with each single member; a service in its own
    process computes every control step.
    """
    from egp_service.cli.demo import drive_laps
    from egp_service.cli.status_line import StatusLine
    from egp_service.cli.tables import summary_table
    from egp_service.simulation.report import draw_comparison, draw_run
    from egp_service.simulation.runs import new_folder

    console = Console()
    start = time.perf_counter()
    folder = new_folder(output, "demo")
    library = _trained(folder) if train else None
    with StatusLine(console) as line:
        laps = drive_laps(library, folder, line.show)
    console.print(summary_table([(lap.label, lap.run.summary) for lap in laps]))
    with console.status("Drawing ..."):
        overview = draw_comparison([(lap.label, lap.run) for lap in laps], folder / "laps.png")
        for lap in laps:
            draw_run(lap.run, lap.folder)
    _explain(console, laps)
    console.print(f"Took {time.perf_counter() - start:.0f} s. Look at:", highlight=False)
    for path in (overview, laps[0].folder / "weights.png", folder):
        console.print(f"  {path}", highlight=False)


def _trained(folder: Path) -> Path:
    from egp_service.cli.commands import train
    from egp_service.shipped import DEMO_RECIPE

    library = folder / "library.safetensors"
    train.train(library, recipe=DEMO_RECIPE)
    return library


def _explain(console: Console, laps: "list[Lap]") -> None:
    """Print a sentence about the table."""
    ensemble, *alone = laps
    lost = [lap.label for lap in alone if not lap.run.summary.ending.completed]
    worst = max(lap.run.summary.lateral_error.max for lap in alone)
    own = ensemble.run.summary.lateral_error.max
    if not ensemble.run.summary.ending.completed:
        console.print("[red]The ensemble did not complete the lap.[/]")
    elif lost:
        console.print(
            f"The ensemble stays within {own:.2f} m of the path; {' and '.join(lost)} did not "
            "complete the lap."
        )
    else:
        console.print(
            f"The ensemble stays within {own:.2f} m of the path, the others {worst:.2f} m."
        )
