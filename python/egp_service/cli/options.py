"""Options that several commands share."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated

import typer

from egp_service._core import EgpError
from egp_service.files import destination, make_folder

Jobs = Annotated[int | None, typer.Option(min=1, help="Processes; one per core by default.")]
Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Work on a Ray cluster instead. Needs the extra cluster, and on its machines the same "
        "version; `egp evaluate` also needs its files there, at the same paths.",
    ),
]

Recording = Annotated[
    Path,
    typer.Argument(
        help="A run.mcap of `egp drive` or `Recorder`, or its folder.", show_default=False
    ),
]
NOT_COMPLETED = 3
"""Exit status of a command whose runs were not completed."""
RunsFolder = Annotated[Path, typer.Option("--output", "-o", help="Folder of the runs.")]


def fleet_and_name(vehicle: str | None) -> tuple[str, str]:
    """Return fleet and name of a vehicle given as FLEET/NAME or, in fleet `default`, as NAME."""
    fleet, slash, name = (vehicle or "vehicle-1").rpartition("/")
    return fleet if slash else "default", name


def recording_file(path: Path) -> Path:
    """Return a recording, which for the folder of a drive is the one in it.

    A folder without a recording is an error.
    """
    if not path.is_dir():
        return path
    file = path / "run.mcap"
    if not file.is_file():
        raise EgpError(
            f"expected a recording, got the folder {path}, in which there is no run.mcap: give the "
            "file of a recording, or a folder that `egp drive` made, such as runs/TIME-NAME"
        )
    return file


def check_unused(options: Mapping[str, object], reason: str) -> None:
    """Errors if one of these options has a value; `reason` says why they cannot be used."""
    if given := [name for name, value in options.items() if value]:
        raise EgpError(f"{', '.join(given)} {reason}")


def check_writable(*files: Path | None) -> None:
    """Errors if a file that a command will write cannot be written, or is no regular file.

    Folders that are missing are made.

    Raises:
        EgpError: naming the file.
        OSError: naming the file, if it is a pipe, a socket or a device, or cannot be looked up, as
            below another file or behind links that lead to each other, and naming a folder that
            cannot be made.

    """
    for file in files:
        if file is None:
            continue
        if file.is_dir():
            raise EgpError(f"{file} is a folder: name a file in it")
        folder = destination(file).parent
        make_folder(folder)
        try:
            with TemporaryFile(dir=folder):
                pass
        except OSError as error:
            raise EgpError(f"{file}: no file can be written there ({error.strerror})") from error


def check_outputs(inputs: Iterable[Path | None], *outputs: Path | None) -> None:
    """Errors if a file that a command writes is one that it reads, or another that it writes."""
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
