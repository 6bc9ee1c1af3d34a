"""Programs of this project that are built from Rust."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Final

from egp_service._core import EgpError

if TYPE_CHECKING:
    from collections.abc import Sequence

PASS_ON: Final = {"allow_extra_args": True, "ignore_unknown_options": True}
"""Settings of a command that hands all options over to a program."""


def run_program(name: str, arguments: Sequence[str]) -> int:
    """Run the program of this name and return its exit code.

    It is looked for on the PATH and in the folder of a build from the source.

    Raises `EgpError` if it is in neither.
    """
    built = Path("target/release") / name
    program = shutil.which(name) or (str(built) if built.is_file() else None)
    if program is None:
        raise EgpError(
            f"the program {name} is neither on the PATH nor at {built}: build it in the source "
            f"folder with `cargo build --release -p {name}`"
        )
    return subprocess.run([program, *arguments], check=False).returncode
