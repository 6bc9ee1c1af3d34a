"""`egp fetch`."""

import json
from pathlib import Path
from typing import Annotated

import typer


def fetch(
    *,
    sha256: Annotated[
        str, typer.Argument(help="SHA-256 of the library (64 digits).", show_default=False)
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="File of the library.", show_default=False)
    ],
    connect: Annotated[
        list[str] | None,
        typer.Option(help="Endpoint of a replica or router; may be given more than once."),
    ] = None,
    zenoh: Annotated[
        Path | None,
        typer.Option(help="Configuration of zenoh in JSON5 (operator.json5 of `egp keys`)."),
    ] = None,
    keys: Annotated[
        Path | None,
        typer.Option(help="Public keys of those who may sign it (library.pub of `egp keys`)."),
    ] = None,
    timeout: Annotated[
        float, typer.Option(min=0.0, max=3600.0, help="Time in which a replica is found, s.")
    ] = 10.0,
) -> None:
    """Fetch a library by its SHA-256 from any replica that serves it.

    The bytes are checked before the file is replaced: their SHA-256, the
    signature if --keys is given, and the library as each service checks it. If
    the replica has a signature, it is written beside the library, with .sig
    behind its name. A file that holds the library already is left as it is.
    A running service that watches the file (`egp serve --watch`) serves the
    library from then on.

    `egp inspect` shows the SHA-256 of a library.

    For example:
      egp fetch 6f1c... --connect tcp/10.0.0.5:7447 -o library.safetensors
    """
    from egp_service._core import EgpError, fetch_library
    from egp_service.cli.waiting import waiting
    from egp_service.control.endpoints import check_endpoints
    from egp_service.control.toml_text import dumps
    from egp_service.zenoh_threads import use_for_service

    if not connect and zenoh is None:
        raise EgpError(
            "no replica to fetch from: give --connect ENDPOINT, or --zenoh FILE with endpoints"
        )
    check_endpoints(connect or [])
    network: dict[str, object] = {"library": str(output)}
    if zenoh is not None:
        network["zenoh_file"] = str(zenoh)
    if connect:
        network["zenoh"] = {"connect/endpoints": json.dumps(connect)}
    use_for_service(dumps(network), network.get("zenoh_file"))
    with waiting("a replica", connect or [], timeout):
        replica = fetch_library(sha256, output, dumps(network), library_keys=keys, timeout=timeout)
    if replica is None:
        typer.echo(f"{output} holds this library already.")
    else:
        typer.echo(f"Fetched {output} ({output.stat().st_size} bytes) from replica {replica}.")
