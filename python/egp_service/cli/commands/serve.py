"""`egp serve`."""

import json
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from egp_service._core import Ready


def serve(
    *,
    library: Annotated[
        Path | None,
        typer.Argument(help="Library file, made by `egp train`.", show_default=False),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Configuration file (TOML).")
    ] = None,
    fetch: Annotated[
        str | None,
        typer.Option(
            metavar="SHA256",
            help="SHA-256 of the library; if the file does not hold it, it is fetched from the "
            "replicas at --connect, which have 30 s to answer.",
        ),
    ] = None,
    replica: Annotated[
        str | None, typer.Option(help="Name that no other replica has; `main` by default.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Threads that run control steps; one a core by default."),
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(
            help="Endpoint to listen on, such as tcp/0.0.0.0:7447; may be given more than once."
        ),
    ] = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(
            help="Endpoint of a router or peer to connect to; may be given more than once."
        ),
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(help="Settings of the control step (TOML), in place of the file's."),
    ] = None,
    watch: Annotated[
        bool,
        typer.Option(
            "--watch", help="Load the library again when its file changes, and not only on SIGHUP."
        ),
    ] = False,
    http: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Address for /health, /ready and /metrics over HTTP, such as 127.0.0.1:9464.",
        ),
    ] = None,
    log_json: Annotated[
        bool, typer.Option("--log-json", help="Log one JSON object a line.")
    ] = False,
    traces: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File to which the spans of requests are appended as JSON lines of OpenTelemetry.",
        ),
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            "--check",
            help="Check configuration, library and network settings, print what would be served, "
            "and end.",
        ),
    ] = False,
) -> None:
    """Answer the control steps of vehicles over zenoh, until SIGTERM or Ctrl-C.

    Options of the command line override the configuration file, which
    section 2 of docs/settings.md describes. It also has what has no option here:
    keys of vehicles, queue, zenoh settings. Plans are made for the vehicle that
    the library states.

    Without an endpoint to listen on it listens on tcp/127.0.0.1:7447 only. A
    service that other machines reach needs keys, TLS and access control (see
    `egp keys`): others could answer in its place, and command the cars.

    On SIGHUP, or with --watch when the file changes, it loads and checks the
    library again beside the old one. Vehicles that start from then on get the
    new library; those that drive keep theirs, which is still served. A file that
    cannot be used changes nothing. On SIGTERM it drains: it withdraws its
    announcement, answers the requests that wait, and ends with status 0.

    For example:
      egp serve library.safetensors --listen tcp/0.0.0.0:7447
      egp serve --config service.toml
      egp serve --config service.toml --check
      egp serve l.safetensors --fetch 6f1c... --connect tcp/10.0.0.5:7447
    """
    if not check:
        # The service has a handler of its own for SIGHUP; until then the signal has no effect. It
        # is not ignored, because programs that this process starts would inherit that.
        signal.signal(signal.SIGHUP, lambda *_: None)
    from egp_service._core import EgpError, check_service
    from egp_service._core import serve as serve_until_signal
    from egp_service.cli.settings_file import naming, read_service, read_settings
    from egp_service.control.endpoints import SERVICE_ENDPOINT, check_endpoints, check_free
    from egp_service.control.toml_text import dumps
    from egp_service.zenoh_threads import use_for_service

    table: dict[str, object] = {}
    if config is not None:
        table = read_service(config)
    elif library is None:
        raise EgpError("nothing to serve: give a library file, or --config service.toml")
    given: dict[str, object] = {"replica": replica, "workers": workers, "http": http}
    given["fetch"] = fetch
    given["library"] = None if library is None else str(library)
    given["settings"] = None if settings is None else read_settings(settings)
    given["log_json"] = log_json or None
    given["traces"] = None if traces is None else str(traces)
    table |= {name: value for name, value in given.items() if value is not None}
    if watch and not table.get("watch_ms"):
        table["watch_ms"] = 500
    check_endpoints([*(listen or []), *(connect or [])])
    _add_endpoints(table, {"listen/endpoints": listen, "connect/endpoints": connect})
    if check:
        with naming(config):
            served, warnings = check_service(dumps(table))
        _show(served)
        for warning in warnings:
            typer.echo(f"egp: {warning}", err=True)
        return
    if config is None or listen:
        check_free(listen or [SERVICE_ENDPOINT])
    use_for_service(dumps(table), table.get("zenoh_file"))
    with naming(config):
        serve_until_signal(dumps(table))


def _add_endpoints(table: dict[str, object], endpoints: Mapping[str, Sequence[str] | None]) -> None:
    """Put endpoints of the command line in place of those of a configuration."""
    stated = {key: json.dumps(values) for key, values in endpoints.items() if values}
    zenoh = table.get("zenoh", {})
    # A value that is no table is an error of the service.
    if stated and isinstance(zenoh, dict):
        table["zenoh"] = zenoh | stated


def _show(served: "Ready") -> None:
    """Print what would be served."""
    typer.echo(f"library {served.library.hex()}")
    typer.echo(f"surfaces: {', '.join(served.members)}")
    typer.echo(f"period {served.dt:g} s, horizon {served.horizon}, window {served.history}")
    for other in served.others:
        typer.echo(f"further library {other.hex()}")
    typer.echo("Configuration, library and network settings are valid.")
