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

    All other options are those of the program egp-load: --connect ENDPOINT (by
    default tcp/127.0.0.1:7447), --vehicles 4, --seconds 20, --json FILE and
    more; `egp load -- --help` lists them. The program is built from the
    source by `cargo build --release -p egp-load`.

    Look at `generator lag` first: if it is far above a millisecond, the other
    times describe this machine instead of the service.

    For example:
      egp serve library.safetensors &
      egp load --vehicles 8 --seconds 20
      egp load --replay run.mcap --vehicles 32 --ramp 0.99 --seconds 5
    """
    from tempfile import TemporaryDirectory

    from egp_service.cli.programs import run_program
    from egp_service.control.recorded import read_recording, write_requests

    if replay is None:
        raise typer.Exit(run_program("egp-load", context.args))
    with TemporaryDirectory(prefix="egp-load-") as folder:
        requests = Path(folder) / "requests.bin"
        write_requests(read_recording(replay), requests)
        code = run_program("egp-load", ["--requests", str(requests), *context.args])
    raise typer.Exit(code)
