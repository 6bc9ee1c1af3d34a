"""Signals that end a command: they raise an exception, so that the command can clean up."""

from __future__ import annotations

import signal
import sys
from typing import NoReturn

# The signals that came, the newest last.
_received: list[int] = []


def install() -> None:
    """Let SIGTERM and SIGHUP exit with 128 + their number, and SIGINT raise `KeyboardInterrupt`."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _end)
    signal.signal(signal.SIGINT, _interrupt)


def check() -> None:
    """Raise again what a signal raised before, if it is lost.

    That happens if the signal comes while an extension calls back into Python: whatever is raised
    there does not reach the caller of the extension.
    """
    if _received:
        _raise(_received[-1])


def _end(number: int, _: object) -> NoReturn:
    for ending in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, signal.SIG_IGN)  # a second one must not interrupt the cleaning up
    _received.append(number)
    _raise(number)


def _interrupt(number: int, _: object) -> NoReturn:
    _received.append(number)
    _raise(number)


def _raise(number: int) -> NoReturn:
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(128 + number)
