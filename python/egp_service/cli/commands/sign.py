"""`egp sign`."""

from pathlib import Path
from typing import Annotated

import typer


def sign(
    library: Annotated[Path, typer.Argument(help="Library file.", show_default=False)],
    key: Annotated[
        Path, typer.Option(help="Private key (library.key of egp keys).", show_default=False)
    ],
) -> None:
    """Sign a library, so that services with the public key serve it.

    The signature is written beside the library. Services with library_keys in
    their configuration serve no library without one. Put the signature in place
    before the library that it is for.

    For example:
      egp sign library.safetensors --key secrets/library.key
    """
    from egp_service._core import Library
    from egp_service.cli.signing import sign_library

    Library.load(library)  # an error if it is none
    typer.echo(f"Wrote {sign_library(library, key)}.")
