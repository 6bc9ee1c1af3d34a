"""`egp view`."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from egp_service.cli.options import Recording, recording_file


def view(
    recording: Recording,
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            "--save", metavar="FILE.rrd", help="Write a file of Rerun in place of opening it."
        ),
    ] = None,
) -> None:
    """Show a recording in the viewer of Rerun, on a map and in curves.

    The map has the road, the car, what it drove and the plan of each step. The
    curves are those of lateral error, speed, friction with its interval, weights,
    commands and step times; mode and status are shown as states and as text
    (docs/recordings.md). The command ends when the window is closed.

    For example:
      egp view runs/20260101-120000-random/run.mcap
      egp view run.mcap --save run.rrd    (then: rerun run.rrd)
    """
    from rich.console import Console

    console = Console()
    recording = recording_file(recording)
    with console.status("Reading ..."):
        from egp_service.view.run import read_run
        from egp_service.view.viewer import save, show

        run = read_run(recording)
    seconds = (max(run.steps) - min(run.steps)) * 1e-9
    typer.echo(f"{recording}: {len(run.steps)} control steps in {seconds:.1f} s")
    if run.missing:
        typer.echo(run.missing)
    name = "/".join(recording.resolve().parts[-2:])
    if output is not None:
        with console.status("Writing ..."):
            save(run, name, output)
        typer.echo(f"Saved {output}; `rerun {output}` opens it.")
        return
    with TemporaryDirectory() as folder:
        file = Path(folder, "run.rrd")
        with console.status("Writing ..."):
            save(run, name, file)
        show(file)
