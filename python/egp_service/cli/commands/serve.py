"""`egp serve`."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer


def serve(
    library: Annotated[
        Path | None,
        typer.Argument(help="Library file, unless --config is given.", show_default=False),
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(help="Endpoint to listen on, such as tcp/0.0.0.0:7447; repeat for more."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Service configuration (TOML).")
    ] = None,
    replica: Annotated[
        str | None, typer.Option(help="Name of this replica, unique in the fleet.")
    ] = None,
    settings: Annotated[
        Path | None, typer.Option(help="Settings of the control step (TOML).")
    ] = None,
) -> None:
    """Serve control steps to vehicles until SIGTERM or Ctrl-C, then drain and exit.

    For example:
      egp serve library.safetensors --listen tcp/0.0.0.0:7447
      egp serve --config service.toml
    """
    from egp_service._core import EgpError
    from egp_service._core import serve as serve_until_signal
    from egp_service.control.toml_text import dumps

    if config is not None:
        if any(value is not None for value in (library, listen, replica, settings)):
            raise typer.BadParameter("--config excludes other options: put them into the file")
        table, folder = _read(config), config.parent
        for name in ("library", "vehicle_keys", "zenoh_file"):
            if name in table:
                table[name] = str(folder / table[name])
    elif library is not None:
        table = {"library": str(library)}
        if replica is not None:
            table["replica"] = replica
        if listen:
            table["zenoh"] = {"listen/endpoints": json.dumps(listen)}
        if settings is not None:
            table["settings"] = _read(settings)
    else:
        raise EgpError("nothing to serve: give a library file, or --config service.toml")
    serve_until_signal(dumps(table))


def _read(file: Path) -> dict[str, Any]:
    import tomllib

    from egp_service._core import EgpError

    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise EgpError(f"{file} is not TOML: {error}") from error
