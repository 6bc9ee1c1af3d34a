"""`egp load`."""

from pathlib import Path
from typing import Annotated

import typer


def load(
    context: typer.Context,
    replay: Annotated[
        Path | None,
        typer.Option(
            help="Recording (run.mcap) whose requests are sent without a plant.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Load a running service with simulated vehicles, and report answer times.

    All other options are --connect ENDPOINT (by default tcp/127.0.0.1:7447),
    --vehicles 4, --seconds 20, --json FILE and more; `egp load -- --help`
    lists them.

    Look at `generator lag` first: if it is far above a millisecond, the other
    times describe this machine instead of the service.

    For example:
      egp serve library.safetensors &
      egp load --vehicles 8 --seconds 20
      egp load --replay run.mcap --vehicles 32 --ramp 0.99 --seconds 5
    """
    from tempfile import TemporaryFile

    from egp_service._core import run_load
    from egp_service.cli.programs import run_program
    from egp_service.control.recorded import read_recording, write_requests

    if replay is None:
        raise typer.Exit(run_program(run_load, context.args))
    # The file has no name, so that nothing is left behind if a signal ends the program.
    with TemporaryFile() as file:
        write_requests(read_recording(replay), file)
        file.seek(0)
        requests = f"/dev/fd/{file.fileno()}"
        raise typer.Exit(run_program(run_load, ["--requests", requests, *context.args]))
