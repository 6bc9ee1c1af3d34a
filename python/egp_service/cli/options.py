"""Options that several commands share."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

import typer

from egp_service._core import EgpError

Jobs = Annotated[int | None, typer.Option(min=1, help="Processes; one per core by default.")]
Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Work on a Ray cluster instead. Needs the extra cluster, and on its machines the same "
        "files and version.",
    ),
]


def fleet_and_name(vehicle: str | None) -> tuple[str, str]:
    """Return fleet and name of a vehicle given as FLEET/NAME or, in fleet `default`, as NAME."""
    fleet, slash, name = (vehicle or "vehicle-1").rpartition("/")
    return fleet if slash else "default", name


def check_unused(options: Mapping[str, object], reason: str) -> None:
    """Errors if one of these options has a value, which is why they cannot be used.

    Raises:
        EgpError: naming the options that were given, and the reason.

    """
    if given := [name for name, value in options.items() if value]:
        raise EgpError(f"{', '.join(given)} {reason}")


def check_outputs(inputs: Iterable[Path | None], *outputs: Path | None) -> None:
    """Errors if a file that a command writes is one that it reads, or another that it writes.

    Raises:
        EgpError: naming both files, before anything is written.

    """
    taken = [file for file in inputs if file is not None]
    for output in outputs:
        if output is None:
            continue
        for file in taken:
            if file.exists() and output.exists():
                same = file.samefile(output)
            else:
                same = file.absolute() == output.absolute()
            if same:
                raise EgpError(
                    f"{output} would overwrite {file}, which this command reads or writes, too: "
                    "name another output"
                )
        taken.append(output)
