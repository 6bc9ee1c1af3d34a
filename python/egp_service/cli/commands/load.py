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
    report: Annotated[
        Path | None, typer.Option("--json", help="File of the report.", show_default=False)
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(
            help="With --replay: picture of shares and latencies over the load (extra "
            "viz). Without --json, the report is beside it.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Load a running service with simulated vehicles, and report answer times.

    All other options are --connect ENDPOINT (by default tcp/127.0.0.1:7447),
    --vehicles 4, --seconds 20 and more; `egp load -- --help` lists them.

    The vehicles are the built-in car. A service with a library of your own car
    is loaded with --replay and a recording of that car.

    Look at `generator lag` first: if it is far above a millisecond, the other
    times describe this machine instead of the service.

    For example:
      egp serve library.safetensors &
      egp load --vehicles 8 --seconds 20
      egp load --replay run.mcap --vehicles 32 --ramp 0.99 --figure knee.png
    """
    from tempfile import TemporaryFile

    from egp_service._core import EgpError, run_load
    from egp_service.cli.options import check_outputs
    from egp_service.cli.programs import run_program
    from egp_service.control.recorded import read_recording, write_requests

    arguments = list(context.args)
    if figure is not None:
        from egp_service.simulation.load_figure import draw_load
        from egp_service.simulation.report import check_picture

        if replay is None:
            raise EgpError(
                "a picture shows rates of recorded requests: give --replay run.mcap, and "
                "--ramp 0.99 for rising rates"
            )
        check_picture(figure)
        report = report or figure.with_suffix(".json")
    check_outputs([replay], report, figure)
    if report is not None:
        arguments += ["--json", str(report)]
    if replay is None:
        stated = {argument.partition("=")[0] for argument in arguments}
        if "--ramp" in stated and "--requests" not in stated:
            raise EgpError("--ramp raises the rate of recorded requests: give --replay run.mcap")
        raise typer.Exit(run_program(run_load, arguments))
    # The file has no name, so that nothing is left behind if a signal ends the program.
    with TemporaryFile() as file:
        write_requests(read_recording(replay), file)
        file.seek(0)
        requests = f"/dev/fd/{file.fileno()}"
        code = run_program(run_load, ["--requests", requests, *arguments])
    if code == 0 and figure is not None and report is not None:
        draw_load(report, figure)
        typer.echo(f"The picture is {figure}, and its figures are in {report}.")
    raise typer.Exit(code)
