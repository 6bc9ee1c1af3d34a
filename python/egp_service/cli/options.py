"""Options that several commands share."""

from typing import Annotated

import typer

Jobs = Annotated[int | None, typer.Option(min=1, help="Processes; one per core by default.")]
Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Work on a Ray cluster instead. Needs the extra cluster, and on its machines the same "
        "files and version.",
    ),
]
