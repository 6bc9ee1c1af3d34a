"""`egp load`."""

from pathlib import Path
from typing import Annotated

import typer

from egp_service.control.endpoints import SERVICE_ENDPOINT

_WAIT_SECONDS = 10.0  # as long as the program waits


def load(
    context: typer.Context,
    replay: Annotated[
        Path | None,
        typer.Option(
            help="Recording (run.mcap or its folder) whose requests are sent without a plant.",
            show_default=False,
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--json", help="File of the report.", show_default=False)
    ] = None,
    picture: Annotated[
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
      egp load --replay run.mcap --vehicles 32 --ramp 0.99 --picture knee.png
    """
    from tempfile import TemporaryFile

    from egp_service._core import EgpError
    from egp_service.cli.options import check_outputs, check_writable, recording_file
    from egp_service.control.recorded import read_recording, write_requests

    arguments = list(context.args)
    if picture is not None:
        from egp_service.simulation.load_figure import draw_load
        from egp_service.simulation.report import check_picture

        if replay is None:
            raise EgpError(
                "a picture shows rates of recorded requests: give --replay run.mcap, and "
                "--ramp 0.99 for rising rates"
            )
        check_picture(picture)
        check_writable(picture)
        report = report or picture.with_suffix(".json")
    if replay is not None:
        replay = recording_file(replay)
    check_outputs([replay], report, picture)
    stated = {argument.partition("=")[0] for argument in arguments}
    if report is not None:
        arguments += ["--json", str(report)]
    if replay is None:
        if "--ramp" in stated and "--requests" not in stated:
            raise EgpError("--ramp raises the rate of recorded requests: give --replay run.mcap")
        raise typer.Exit(_run(arguments))
    _check_replayed(stated)
    # The file has no name, so that nothing is left behind if a signal ends the program.
    with TemporaryFile() as file:
        recorded = read_recording(replay)
        if not recorded.steps:
            raise EgpError(f"{replay} has no step to replay. {recorded.missing}".rstrip())
        write_requests(recorded, file)
        file.seek(0)
        requests = f"/dev/fd/{file.fileno()}"
        code = _run(["--requests", requests, *arguments])
    if code == 0 and picture is not None and report is not None:
        draw_load(report, picture)
        typer.echo(f"The picture is {picture}, and its figures are in {report}.")
    raise typer.Exit(code)


def _check_replayed(stated: set[str]) -> None:
    """Check that no option is stated that recorded requests do not use."""
    from egp_service._core import EgpError

    for option in ("--key", "--status", "--track", "--friction", "--grip"):
        if option in stated:
            raise EgpError(
                f"{option} is for simulated vehicles, and --replay sends recorded requests as they "
                "are: leave one of the two out"
            )


def _run(arguments: list[str]) -> int:
    """Run the program, and say meanwhile if it waits for a service."""
    from egp_service._core import run_load
    from egp_service.cli.programs import run_program
    from egp_service.cli.waiting import waiting

    endpoints = _endpoints(arguments)
    with waiting("a service", endpoints, _WAIT_SECONDS, unless_reachable=True):
        return run_program(run_load, arguments)


def _endpoints(arguments: list[str]) -> list[str]:
    """Return the endpoints to which the program connects, as far as its arguments state them."""
    found = []
    for argument, after in zip(arguments, [*arguments[1:], ""], strict=True):
        if argument == "--connect":
            found.append(after)
        elif argument.startswith("--connect="):
            found.append(argument.partition("=")[2])
    zenoh = any(argument.partition("=")[0] == "--zenoh" for argument in arguments)
    return found or ([] if zenoh else [SERVICE_ENDPOINT])
