"""`egp map`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from egp_service.control.endpoints import MAP_ENDPOINT, MAP_PORT, check_free


def keep_map(
    *,
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Configuration (TOML) in place of other options."),
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Endpoint to listen on; repeat for more. By default {MAP_ENDPOINT}, which "
            "only this machine reaches."
        ),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(help="Folder of the map's files; without it the map ends with the service."),
    ] = None,
    lifetime: Annotated[
        float | None,
        typer.Option(help="Time in s in which the information of evidence falls to 1/e; 1800."),
    ] = None,
    capacity: Annotated[
        float | None,
        typer.Option(help="Largest evidence of one vehicle about 2 m of a road, nats; 6."),
    ] = None,
    vehicles: Annotated[
        int | None, typer.Option(help="Vehicles whose evidence a tile of 128 m keeps; 16.")
    ] = None,
    contributions: Annotated[
        int | None,
        typer.Option(help="Tiles of all vehicles that are kept, of 3.3 kB each; 65536."),
    ] = None,
    check: Annotated[
        bool,
        typer.Option("--check", help="Check configuration and network settings, and end."),
    ] = False,
) -> None:
    """Keep the map of a fleet: what its vehicles measure about the friction of roads.

    Vehicles send what they measured and ask for what the others did. The map
    adds it up for each place; a friction that only a minority of the
    vehicles excludes is not excluded. Evidence ages. It runs until SIGTERM,
    SIGHUP or Ctrl-C. Anybody who reaches the endpoint can contribute under
    any name: outside a trusted network give it the `map.json5` of `egp keys`
    (docs/map.md).

    For example:
      egp map --folder roads
      egp drive -s random --fleet tcp/127.0.0.1:7448 --vehicle car-1
      egp drive -s random --fleet tcp/127.0.0.1:7448 --vehicle car-2    (faster)
    """
    from egp_service._core import EgpError, check_map, serve_map
    from egp_service.cli.settings_file import naming, read_map
    from egp_service.control.toml_text import dumps
    from egp_service.zenoh_threads import use_for_service

    options: dict[str, object] = {
        "folder": None if folder is None else str(folder),
        "lifetime": lifetime,
        "capacity": capacity,
        "vehicles": vehicles,
        "contributions": contributions,
    }
    given = {name: value for name, value in options.items() if value is not None}
    if config is not None and (given or listen):
        raise EgpError("--config excludes other options: put them into the file")
    if config is None and not check:
        check_free(listen or [MAP_ENDPOINT], MAP_PORT)
    if listen:
        given["zenoh"] = {"listen/endpoints": json.dumps(listen)}
    if config is not None:
        given = read_map(config)
    with naming(config):
        if not check:
            use_for_service(dumps(given), given.get("zenoh_file"))
            serve_map(dumps(given))
            return
        warning = check_map(dumps(given))
        typer.echo("Configuration and network settings are valid.")
        if warning is not None:
            typer.echo(f"egp: {warning}", err=True)
