"""`egp inspect`."""

from pathlib import Path
from typing import Annotated

import typer


def inspect(
    library: Annotated[Path, typer.Argument(help="Library file.", show_default=False)],
) -> None:
    """Show a library's surfaces, sizes, lengthscales, envelope and identity.

    For example: egp inspect library.safetensors
    """
    from egp_service.cli import inspect_library

    inspect_library.inspect(library)
