"""`egp inspect`."""

from pathlib import Path
from typing import Annotated

import typer


def inspect(
    library: Annotated[Path, typer.Argument(help="Library file.", show_default=False)],
) -> None:
    """Show what is inside a library: surfaces, sizes, lengthscales, envelope, identity.

    For example: egp inspect library.safetensors
    """
    from egp_service import inspect_library

    inspect_library.inspect(library)
