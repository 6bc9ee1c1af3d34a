"""Files of settings of the control step."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING, Final

from egp_service._core import EgpError, check_settings

if TYPE_CHECKING:
    from pathlib import Path

_OF_A_SERVICE: Final = {"library", "replica", "workers", "zenoh", "zenoh_file", "settings"}


def read_text(path: Path) -> str:
    """Read a TOML file's text.

    Raises:
        EgpError: naming the file if it is no text.
        OSError: if the file cannot be read.

    """
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise EgpError(f"{path}: expected a TOML file, got bytes that are no UTF-8 text") from error


def read_settings(path: Path) -> dict[str, object]:
    """Read settings of the control step; `egp settings` lists them.

    Raises:
        EgpError: naming the file and its line for text that is no TOML, and for settings that do
            not exist or have the wrong type or value.
        OSError: if the file cannot be read.

    """
    text = read_text(path)
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise EgpError(f"{path}: {error}") from error
    if found := sorted(_OF_A_SERVICE & set(table)):
        raise EgpError(
            f"{path}: `{found[0]}` belongs to the configuration of a service; give the file with "
            "`egp serve --config`, or only its table [settings] here"
        )
    try:
        check_settings(text)
    except EgpError as error:
        raise EgpError(f"{path}: {error}; `egp settings` lists all settings") from error
    return table
