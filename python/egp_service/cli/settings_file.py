"""Files of settings of the control step."""

from __future__ import annotations

import re
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from egp_service._core import EgpError, check_settings
from egp_service.cli.settings_text import read_settings_document
from egp_service.files import read_toml

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_PATHS: Final = ("library", "folder", "traces", "vehicle_keys", "library_keys", "zenoh_file")

# How an error of TOML shows a place: its line and column, and the line with the column marked.
_PLACE: Final = re.compile(r"TOML parse error at line \d+, column \d+\n[ |]*\n *\d+ \| (.*)\n.*\n")
_LONGEST: Final = 120
"""Characters of a line of a file, or of a name or value in it, that an error shows."""
_SHOWN_LINE: Final = re.compile(rf"^([ \d]*\| .{{{_LONGEST}}}).+", re.MULTILINE)
# The path of a file may be longer than that, and is shown as a whole.
_LONG_WORD: Final = re.compile(rf'([^\s`"]{{{_LONGEST}}})[^\s`"]{{{2 * _LONGEST},}}')


def read_settings(path: Path) -> dict[str, object]:
    """Read settings of the control step; `egp settings` lists them.

    Raises:
        EgpError: naming the file, if it cannot be read or is not TOML, and for settings that do
            not exist or have the wrong type or value.

    """
    text, table = read_toml(path)
    if found := sorted(_keys("Service") & set(table)):
        raise EgpError(
            f"{path}: `{found[0]}` belongs to the configuration of a service; give the file with "
            "`egp serve --config`, or only its table [settings] here"
        )
    try:
        check_settings(text)
    except EgpError as error:
        told = _shortened(str(error)).strip()
        raise EgpError(f"{path}: {told}; `egp settings` lists all settings") from error
    return table


def read_service(path: Path) -> dict[str, object]:
    """Read the configuration of a service, of which the service checks the rest.

    Its relative paths start at the file's folder.

    Raises:
        EgpError: naming the file, if it cannot be read or is not TOML, and for settings of the
            control step outside the table `settings`.

    """
    _, table = read_toml(path)
    found = sorted(_keys("Control step") & set(table))
    if found and "library" not in table and "settings" not in table:
        raise EgpError(
            f"{path}: `{found[0]}` is a setting of the control step, expected the "
            f"configuration of a service; try `egp serve LIBRARY --settings {path}`"
        )
    return _with_folder(table, path.parent)


def read_map(path: Path) -> dict[str, object]:
    """Read the configuration of a map service, as `read_service`."""
    return _with_folder(read_toml(path)[1], path.parent)


@contextmanager
def naming(path: Path | None) -> Iterator[None]:
    """Let errors of a service name the file `path` of its configuration, if it has one.

    A service gets its configuration as a text that is made of this file and the options. Errors
    state lines and columns of that text, in place of which only what stands there is kept.
    """
    try:
        yield
    except EgpError as error:
        if path is None:
            raise
        told = str(error)
        if found := _PLACE.search(told):
            told = (told[: found.start()] + told[found.end() :]).strip()
            if "missing field" not in told:  # such a field has no line
                line = found[1]
                told += f", in the line `{line[:_LONGEST]}{'…' if len(line) > _LONGEST else ''}`"
        error.args = (f"{path}: {_shortened(told)}",)
        raise


def _shortened(told: str) -> str:
    """Cut long lines of a file, and long names and values in it, that an error shows."""
    return _LONG_WORD.sub(r"\1…", _SHOWN_LINE.sub(r"\1…", told))


def _keys(section: str) -> set[str]:
    """Give the first parts of the keys that a section of the document of the settings has."""
    settings = read_settings_document()
    return {each.key.partition(".")[0] for each in settings if each.section == section}


def _with_folder(table: dict[str, object], folder: Path) -> dict[str, object]:
    """Let the relative paths of a configuration start at its folder."""
    paths: dict[str, object] = {
        name: str(folder / path) for name in _PATHS if isinstance(path := table.get(name), str)
    }
    if isinstance(libraries := table.get("libraries"), list):
        paths["libraries"] = [str(folder / str(file)) for file in libraries]
    return table | paths
