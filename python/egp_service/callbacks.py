"""Functions that an extension calls: what they raise does not reach the caller of the extension."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import CodeType, FrameType, FunctionType, MethodType

_codes: set[CodeType] = set()


def mark(function: FunctionType | MethodType) -> None:
    """Note that an extension calls this function, so that no signal is to raise anything in it."""
    _codes.add(function.__code__)


def is_within(frame: FrameType | None) -> bool:
    """Whether a frame is that of a marked function, or of what such a function calls."""
    while frame is not None:
        if frame.f_code in _codes:
            return True
        frame = frame.f_back
    return False
