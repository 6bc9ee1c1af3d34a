"""Conversion between dataclasses and TOML tables.

Unknown fields, missing fields and wrong types are errors that give the full name of the field.
"""

from __future__ import annotations

import math
import typing
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import UnionType
from typing import TypeVar, get_args, get_origin, get_type_hints

from egp_service._core import EgpError


class ConfigurationError(EgpError):
    """A configuration with unknown, missing or invalid fields."""


_T = TypeVar("_T")


def build(cls: type[_T], table: Mapping[str, object], where: str) -> _T:
    """Create a dataclass from a TOML table.

    Raises:
        ConfigurationError: if a field is unknown, missing or of the wrong type.

    """
    if not isinstance(table, Mapping):
        raise ConfigurationError(f"{where} must be a table, got {table!r}")
    known = {item.name: item for item in fields(cls)}  # type: ignore[arg-type]
    if unknown := sorted(set(table) - set(known)):
        raise ConfigurationError(
            f"{where}: unknown field {unknown[0]!r}; known: {', '.join(known)}"
        )
    missing = [
        name
        for name, item in known.items()
        if item.default is MISSING and item.default_factory is MISSING and name not in table
    ]
    if missing:
        raise ConfigurationError(f"{where}: field {missing[0]!r} is missing")
    hints = get_type_hints(cls)
    values = {name: _value(hints[name], value, f"{where}: {name}") for name, value in table.items()}
    return cls(**values)


def _value(kind: object, value: object, where: str) -> object:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (UnionType, typing.Union):  # optional fields, or a name or a table
        tables = [member for member in arguments if get_origin(member) is dict]
        kind = tables[0] if tables and isinstance(value, dict) else arguments[0]
        return _value(kind, value, where)
    if origin is tuple:
        if not isinstance(value, list):
            raise ConfigurationError(f"{where} must be an array of tables")
        return tuple(
            _value(arguments[0], item, f"{where}[{index}]") for index, item in enumerate(value)
        )
    if origin is dict:
        if not isinstance(value, dict):
            raise ConfigurationError(f"{where} must be a table")
        if arguments[1] is float:
            return {key: _value(float, item, f"{where}.{key}") for key, item in value.items()}
        return value
    if is_dataclass(kind):
        return build(
            typing.cast("type[object]", kind), typing.cast("dict[str, object]", value), where
        )
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = _float(value, where)
    if not isinstance(value, typing.cast("type", kind)) or (
        kind is int and isinstance(value, bool)
    ):
        raise ConfigurationError(
            f"{where} must be {getattr(kind, '__name__', kind)}, got {value!r}"
        )
    return _checked(value, where)


def _float(value: int, where: str) -> float:
    try:
        return float(value)
    except OverflowError as error:
        raise ConfigurationError(
            f"{where} must be a number below 1.8e308, got one of {len(str(value))} digits"
        ) from error


def _checked(value: object, where: str) -> object:
    """Return a scalar, or raise if a file cannot hold it or nothing can be computed with it."""
    if isinstance(value, str) and "\0" in value:
        raise ConfigurationError(f"{where} must not contain the character NUL, got {value!r}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigurationError(f"{where} must be a finite number, got {value}")
    return value


def without_none(value: object) -> dict[str, object]:
    """Return the value without optional fields that are not set, because TOML has no null."""

    def strip(item: object) -> object:
        if isinstance(item, dict):
            return {key: strip(child) for key, child in item.items() if child is not None}
        if isinstance(item, list | tuple):
            return [strip(child) for child in item]
        return item

    return typing.cast("dict[str, object]", strip(value))
