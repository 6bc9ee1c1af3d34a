"""Conversion between dataclasses and TOML tables.

Unknown fields, missing fields and wrong types are errors that give the full name of the field.
"""

from __future__ import annotations

import math
import typing
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Final, Literal, TypeVar, get_args, get_origin, get_type_hints

from egp_service._core import EgpError

if TYPE_CHECKING:
    from collections.abc import Mapping


class ConfigurationError(EgpError):
    """A configuration with unknown, missing or invalid fields."""


_T = TypeVar("_T")
_WORDS: Final[Mapping[object, str]] = {
    bool: "true or false",
    dict: "a table",
    float: "a number",
    int: "a whole number",
    str: "a text",
}


def build(cls: type[_T], table: Mapping[str, object], where: str) -> _T:
    """Create a dataclass from a TOML table.

    Fields are numbers, texts, `Literal` of texts, dataclasses, dictionaries, and tuples of these.

    Raises:
        ConfigurationError: naming `where` and the field, if this is unknown, missing or of the
            wrong type, or if the dataclass itself raises an `EgpError`.

    """
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
    try:
        return cls(**values)
    except EgpError as error:
        raise ConfigurationError(f"{where}: {error}") from error


def _value(kind: object, value: object, where: str) -> object:
    """Return a value of TOML as a field has it whose type is `kind`."""
    several = get_origin(kind) in (UnionType, typing.Union)
    kinds = [each for each in get_args(kind) if each is not NoneType] if several else [kind]
    fitting = [each for each in kinds if _fits(value, each)]
    if not fitting:
        expected = " or ".join(map(_in_words, kinds))
        raise ConfigurationError(f"{where} must be {expected}, got {value!r}")
    return _converted(fitting[0], value, where)


def _fits(value: object, kind: object) -> bool:
    """Return whether a value of TOML has a type; the values in a table or an array may not."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        return value in arguments
    if origin is tuple:
        repeats = arguments[-1] is Ellipsis
        return isinstance(value, list) and (repeats or len(value) == len(arguments))
    if is_dataclass(kind):
        return isinstance(value, dict)
    if isinstance(value, bool):
        return kind is bool
    return isinstance(value, (int, float) if kind is float else typing.cast("type", origin or kind))


def _in_words(kind: object) -> str:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        return f"one of {', '.join(map(repr, arguments))}"
    if origin is tuple:
        if arguments[-1] is not Ellipsis:
            return f"an array of {len(arguments)} values"
        if _in_words(arguments[0]) == _WORDS[dict]:
            return "an array of tables, each below a header in double brackets"
        return "an array"
    return _WORDS[dict if is_dataclass(kind) else origin or kind]


def _converted(kind: object, value: object, where: str) -> object:
    """Return a value that fits a type, with all that is in it."""
    arguments = get_args(kind)
    if isinstance(value, list):
        kinds = arguments[:1] * len(value) if arguments[-1] is Ellipsis else arguments
        return tuple(
            _value(each, item, f"{where}[{index}]")
            for index, (each, item) in enumerate(zip(kinds, value, strict=True))
        )
    if is_dataclass(kind):
        return build(
            typing.cast("type[object]", kind), typing.cast("dict[str, object]", value), where
        )
    if isinstance(value, dict) and arguments[1] is float:
        return {key: _value(float, item, f"{where}.{key}") for key, item in value.items()}
    if kind is float and isinstance(value, int):
        value = _float(value, where)
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
