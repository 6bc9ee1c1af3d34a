"""TOML text of configurations.

The standard library reads TOML but does not write it. This module writes the subset that
configurations use: tables, arrays of tables, and arrays of scalars.
"""

from __future__ import annotations

import json
import math
import numbers
import re
from collections.abc import Mapping, Sequence

from egp_service._core import EgpError

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def dumps(table: Mapping[str, object]) -> str:
    """Return the TOML document of `table`; `tomllib.loads` returns the same values.

    Numbers and arrays of numpy are written as numbers and arrays of Python.

    Raises:
        EgpError: for a name that is no text, and, with the keys that lead to it, for a number that
            is not finite and for a value without a form here.

    """
    return "\n".join(_lines(table, ())).strip() + "\n"


def _lines(table: Mapping[str, object], path: tuple[str, ...]) -> list[str]:
    tables = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    arrays = {key: rows for key, value in table.items() if (rows := _table_rows(value))}
    lines = [
        f"{_key(key)} = {_value(value, (*path, key))}"
        for key, value in table.items()
        if key not in tables and key not in arrays
    ]
    for key, value in tables.items():
        child = (*path, key)
        lines += ["", f"[{'.'.join(map(_key, child))}]", *_lines(value, child)]
    for key, rows in arrays.items():
        child = (*path, key)
        for row in rows:
            lines += ["", f"[[{'.'.join(map(_key, child))}]]", *_lines(row, child)]
    return lines


def _table_rows(value: object) -> list[Mapping[str, object]]:
    """Return the tables of an array of tables, or an empty list for any other value."""
    if isinstance(value, str) or not isinstance(value, Sequence):
        return []
    rows = [item for item in value if isinstance(item, Mapping)]
    return rows if len(rows) == len(value) else []


def _key(key: str) -> str:
    if not isinstance(key, str):
        raise EgpError(f"expected texts as names in a configuration, got {key!r}")
    return key if _BARE_KEY.fullmatch(key) else _quoted(key)


def _quoted(text: str) -> str:
    """Quote as JSON does, but for surrogates and the character U+007F, which TOML forbids."""
    if not text.isascii():
        try:
            text.encode()
        except UnicodeEncodeError as error:
            raise EgpError(f"expected text in UTF-8 in a configuration, got {text!r}") from error
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: object, path: tuple[str, ...]) -> str:
    """Write a value; an error names the keys that lead to it."""
    try:
        return _inline(value)
    except EgpError as error:
        raise EgpError(f"{'.'.join(path)}: {error}") from error


def _inline(value: object) -> str:
    if (listed := getattr(value, "tolist", None)) is not None:
        value = listed()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, numbers.Integral):
        return str(int(value))
    if isinstance(value, numbers.Real):
        if not math.isfinite(value):
            raise EgpError(f"expected a finite number in a configuration, got {value}")
        return repr(float(value))
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_inline, value))}]"
    raise EgpError(
        "expected text, a number, true, false, an array or a table in a configuration, got the "
        f"{type(value).__name__} {value}: put it in quotes if it is text"
    )
