"""`egp router`."""

import resource
import signal
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from egp_service.control.endpoints import ROUTER_ENDPOINT, ROUTER_PORT, check_free


def router(
    listen: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Endpoint to listen on; repeat for more. By default {ROUTER_ENDPOINT}, which "
            "only this machine reaches."
        ),
    ] = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(help="Endpoint of another router; repeat for more.", show_default=False),
    ] = None,
    zenoh: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Configuration of zenoh (JSON5), with TLS and access control."
        ),
    ] = None,
) -> None:
    """Route between vehicles and services until SIGTERM or Ctrl-C.

    Vehicles and services connect to it and need not reach each other. It routes
    as zenohd does, and is meant for tests and small fleets. `egp keys` writes
    router.json5, which zenohd reads, too (docs/security.md).

    For example:
      egp router --listen tcp/0.0.0.0:7449
      egp serve --config service.toml    (with connect/endpoints of the router)
      egp drive --connect tcp/127.0.0.1:7449
    """
    from egp_service._core import check_certificates
    from egp_service.cli.signals import until_signal
    from egp_service.control.router import Router

    endpoints = listen or ([] if zenoh else [ROUTER_ENDPOINT])
    check_free(endpoints, ROUTER_PORT)
    if zenoh is not None and (warning := check_certificates(zenoh, "router")) is not None:
        typer.echo(f"egp: {warning}", err=True)
    # Each connection takes a descriptor, also that of a stranger before its handshake ends.
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    # The signal may come while the session opens, which lets vehicles in before it returns.
    with until_signal(), Router(endpoints, connect or (), zenoh) as running:
        Console(soft_wrap=True, markup=False).print(f"Routing on {', '.join(running.endpoints)}.")
        while True:
            signal.pause()
