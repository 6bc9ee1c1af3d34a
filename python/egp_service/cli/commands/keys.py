"""`egp keys`."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from egp_service.cli.output import say


def keys(
    folder: Annotated[Path, typer.Argument(help="Folder of the files.", show_default=False)],
    vehicle: Annotated[
        list[str],
        typer.Option(
            help="Name of a vehicle, new or to renew; repeat for more.", show_default=False
        ),
    ],
    host: Annotated[
        list[str],
        typer.Option(
            help="Host name or IPv4 address under which the service is reached; repeat for more.",
            show_default=False,
        ),
    ],
    fleet: Annotated[str, typer.Option(help="Fleet of the vehicles.")] = "default",
    port: Annotated[
        int | None,
        typer.Option(
            min=1, max=65535, help="Port of the service; by default that of its file, or 7447."
        ),
    ] = None,
    days: Annotated[
        int,
        typer.Option(
            min=1,
            max=3650,
            help="Validity of the certificates; the authority's is ten times as long.",
        ),
    ] = 365,
) -> None:
    """Make keys, certificates and configurations that close a service to strangers.

    Copy each file to the program for which it is named. Keep the folder itself,
    with vehicles.keys, library.pub and the folder vehicles, on a machine where
    neither a service nor a vehicle runs, because later calls read it. Never copy
    ca.key and library.key to another machine. Called again for other
    vehicles, it keeps what is in the folder and adds what is missing; start the
    service again with its new file then. Called again for a vehicle that there
    is, it renews the certificate: the .json5 file is written anew, with the same
    endpoints if it is still there, and the secret key stays. Another --host is
    for the new vehicles; operator and monitor keep their endpoints, and the
    service its port. It is an error if vehicles.keys was moved away from ca.pem
    or from the vehicles' files.

    For example:
      egp keys secrets --vehicle car-1 --vehicle car-2 --host control.example
    """
    from egp_service.cli.credentials import write_credentials

    console = Console(soft_wrap=True)
    report = partial(say, console)
    new = write_credentials(folder, fleet, vehicle, hosts=host, port=port, days=days, report=report)
    renewed = [name for own in dict.fromkeys(vehicle) if (name := f"{fleet}/{own}") not in new]
    console.print(f"New vehicles: {', '.join(new) or 'none'}")
    if renewed:
        report(f"Renewed vehicles, with a new .json5 file each: {', '.join(renewed)}")
    shown = (new or renewed)[0]
    own = folder / "vehicles" / shown.replace("/", "@")
    report(
        f"""
Service, in the file of `egp serve --config`:
  vehicle_keys = "{folder / "vehicles.keys"}"
  library_keys = "{folder / "library.pub"}"    (serves only what `egp sign` signed)
  zenoh_file = "{folder / "service.json5"}"
Map service, in the file of `egp map --config`:
  zenoh_file = "{folder / "map.json5"}"
Vehicle, for instance:
  egp drive --vehicle {shown} --zenoh {own}.json5 --key {own}.keys
Live page, and a router if there is one:
  egp monitor --zenoh {folder / "monitor.json5"}
  egp router --zenoh {folder / "router.json5"}"""
    )
