"""`egp serve`."""

import json
import signal
from pathlib import Path
from typing import Annotated

import typer


def serve(
    *,
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
    watch: Annotated[
        bool,
        typer.Option("--watch", help="Load the library again when its file changes."),
    ] = False,
) -> None:
    """Serve control steps to vehicles until SIGTERM or Ctrl-C, then drain and exit.

    SIGHUP loads the library again, beside the old one: vehicles that start get the new one, and
    those that drive keep theirs. A file that cannot be used changes nothing.

    For example:
      egp serve library.safetensors --listen tcp/0.0.0.0:7447
      egp serve --config service.toml
    """
    from egp_service._core import EgpError
    from egp_service._core import serve as serve_until_signal
    from egp_service.cli.settings_file import read_service, read_settings
    from egp_service.control.endpoints import check_free
    from egp_service.control.toml_text import dumps

    if config is not None:
        if any(value is not None for value in (library, listen, replica, settings)) or watch:
            raise typer.BadParameter("--config excludes other options: put them into the file")
        table = _with_folder(read_service(config), config.parent)
    elif library is not None:
        table = {"library": str(library)}
        if watch:
            table["watch_ms"] = 500
        if replica is not None:
            table["replica"] = replica
        check_free(listen or ["tcp/127.0.0.1:7447"])
        if listen:
            table["zenoh"] = {"listen/endpoints": json.dumps(listen)}
        if settings is not None:
            table["settings"] = read_settings(settings)
    else:
        raise EgpError("nothing to serve: give a library file, or --config service.toml")
    # The service has a handler of its own for SIGHUP; Python's would end the command.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    serve_until_signal(dumps(table))


def _with_folder(table: dict[str, object], folder: Path) -> dict[str, object]:
    """Let the relative paths of a configuration start at its folder."""
    paths: dict[str, object] = {
        name: str(folder / path)
        for name in ("library", "vehicle_keys", "library_keys", "zenoh_file")
        if isinstance(path := table.get(name), str)
    }
    if isinstance(libraries := table.get("libraries"), list):
        paths["libraries"] = [str(folder / str(file)) for file in libraries]
    return table | paths
