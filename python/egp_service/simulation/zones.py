"""Friction zones from a CSV file."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Final

from egp_service.simulation.configuration import ConfigurationError
from egp_service.simulation.scenario_checks import ScenarioError

if TYPE_CHECKING:
    from pathlib import Path

_NUMBERS: Final = ("start", "friction", "right")
_NAMES: Final = ("surface", "surface_right")


def read_zone_rows(path: Path) -> list[dict[str, object]]:
    """Read zones from a CSV file, one a line, with the fields of a scenario's `zones` as header.

    `start` and `friction` or `surface` are needed. Columns are separated by commas or semicolons;
    with semicolons, numbers may have a decimal comma. Empty cells are left out, and lines that
    begin with `#` are comments.

    Raises:
        ConfigurationError: naming file, line and column of what cannot be read.
        ScenarioError: naming the file, if it cannot be read at all.

    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path}: expected a CSV file in UTF-8") from error
    except OSError as error:
        raise ScenarioError(
            f"zones_file {path}: {error.strerror}; state the path of a CSV file, relative to the "
            "scenario's file"
        ) from error
    kept = [(n, line) for n, line in enumerate(lines, 1) if line.strip() and line[0] != "#"]
    if not kept:
        raise ConfigurationError(f"{path}: expected zones with a header such as start,friction")
    separator = ";" if ";" in kept[0][1] else ","
    header, *rows = [_cells(line, separator, f"{path}: line {n}") for n, line in kept]
    names = [name.strip() for name in header]
    if unknown := [name for name in names if name not in {*_NUMBERS, *_NAMES}]:
        raise ConfigurationError(
            f"{path}: unknown column {unknown[0]!r}; known: {', '.join((*_NUMBERS, *_NAMES))}"
        )
    if twice := [name for number, name in enumerate(names) if name in names[:number]]:
        raise ConfigurationError(f"{path}: column {twice[0]!r} comes twice: remove one of them")
    zones: list[dict[str, object]] = []
    for (line, _), row in zip(kept[1:], rows, strict=True):
        if len(row) != len(names):
            raise ConfigurationError(
                f"{path}: line {line} has {len(row)} cells: expected {len(names)}"
            )
        cells = dict(zip(names, (cell.strip() for cell in row), strict=True))
        zones.append(
            {
                name: _number(cell, separator, f"{path}: line {line}: {name}")
                if name in _NUMBERS
                else cell
                for name, cell in cells.items()
                if cell
            }
        )
    return zones


def _cells(line: str, separator: str, where: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator, strict=True))
    except csv.Error as error:
        raise ConfigurationError(f"{where}: {error}; is a quotation mark missing?") from error


def _number(cell: str, separator: str, where: str) -> float:
    try:
        return float(cell.replace(",", ".") if separator == ";" else cell)
    except ValueError as error:
        raise ConfigurationError(f"{where} must be a number, got {cell!r}") from error
