"""`egp load`."""

import typer


def load(context: typer.Context) -> None:
    """Load a running service with simulated vehicles, and report answer times.

    The options are --connect ENDPOINT (by default tcp/127.0.0.1:7447),
    --vehicles 4, --seconds 20, --json FILE and more; `egp load -- --help`
    lists them.

    Look at `generator lag` first: if it is far above a millisecond, the other
    times describe this machine instead of the service.

    For example:
      egp serve library.safetensors &
      egp load --vehicles 8 --seconds 20
    """
    from egp_service._core import run_load
    from egp_service.cli.programs import run_program

    raise typer.Exit(run_program(run_load, context.args))
