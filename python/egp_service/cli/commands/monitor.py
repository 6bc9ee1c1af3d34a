"""`egp monitor`."""

from pathlib import Path
from typing import Annotated

import typer

from egp_service.control.endpoints import (
    MONITOR_ENDPOINT,
    MONITOR_PORT,
    SERVICE_ENDPOINT,
    check_free,
)


def monitor(
    connect: Annotated[
        list[str] | None,
        typer.Option(
            help="Endpoint of a service or router; repeat for more. By default "
            f"{SERVICE_ENDPOINT}, where `egp serve` listens."
        ),
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(help=f"Endpoint for vehicles that connect. By default {MONITOR_ENDPOINT}."),
    ] = None,
    *,
    zenoh: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Configuration of zenoh (JSON5), with TLS and keys."),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address of the page; only this machine reaches the default.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the page; 0 takes a free one.")
    ] = 8642,
) -> None:
    """Show vehicles and replicas on a live page in the browser.

    The page has the state of the fleet and, for one vehicle, map, grip, weights,
    times, commands and errors (docs/monitor.md). It shows whatever publishes to
    the endpoints, loads nothing from elsewhere, and controls nothing. It runs
    until Ctrl-C or SIGTERM, and then ends with status 0.

    For example:
      egp monitor          (then open http://127.0.0.1:8642)
      egp drive --monitor tcp/127.0.0.1:7450 --vehicle car-1
    """
    from egp_service._core import EgpError
    from egp_service.cli.signals import until_signal
    from egp_service.control.certificates import check_zenoh_file
    from egp_service.monitor.web import bind, serve

    given = zenoh is not None
    connected = connect or ([] if given else [SERVICE_ENDPOINT])
    listening = listen or ([] if given else [MONITOR_ENDPOINT])
    check_free(listening, MONITOR_PORT)
    try:
        check_zenoh_file(zenoh, role="operator")
    except EgpError as error:
        if "that of the role" in str(error):
            error.add_note("or monitor.json5, with which the page shows vehicles, too")
        raise
    with until_signal(), bind(host, port) as bound:
        from egp_service.monitor.listener import Listener

        with Listener(connected, listening, zenoh) as listener:
            shown = f"[{host}]" if ":" in host else host
            address = f"http://{shown}:{bound.getsockname()[1]}"
            serve(
                listener,
                bound,
                host,
                lambda: typer.echo(f"Live page: {address}  (Ctrl-C ends it)"),
            )
