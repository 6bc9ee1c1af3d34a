"""Signals that end a command: they raise an exception, so that the command can clean up."""

from __future__ import annotations

import signal
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

from egp_service import callbacks

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import FrameType

    from rich.console import Console

# The signals that came, the newest last.
_received: list[int] = []


def install() -> None:
    """Let SIGTERM and SIGHUP exit with 128 + their number, and SIGINT raise `KeyboardInterrupt`.

    A signal that this process inherited as ignored, as SIGHUP under `nohup`, stays ignored.
    """
    handlers = {signal.SIGTERM: _end, signal.SIGHUP: _end, signal.SIGINT: _interrupt}
    for number, handler in handlers.items():
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)
    sys.unraisablehook = _report_unraisable


def check() -> None:
    """Raise what a signal did not raise, because an extension called back into Python when it came.

    What is raised in such a call does not reach the caller of the extension.
    """
    if _received:
        _raise(_received[-1])


@contextmanager
def naming_folder(console: Console, folder: Path) -> Iterator[None]:
    """Say after Ctrl-C and other signals that what was recorded until then is in a folder."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        told = f"Interrupted. What was recorded until then is in {folder}"
        console.print(told, markup=False, soft_wrap=True)
        raise


@contextmanager
def until_signal() -> Iterator[None]:
    """Run a server, which a signal ends with status 0 because that was asked for."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        if not _received:
            raise


def _report_unraisable(unraisable: sys.UnraisableHookArgs) -> None:
    """Report what Python cannot raise, such as in a callback of a weak reference, as usual.

    The exception of a signal is not reported, because `check` raises it again.
    """
    if not (_received and issubclass(unraisable.exc_type, (SystemExit, KeyboardInterrupt))):
        sys.__unraisablehook__(unraisable)


def _end(number: int, frame: FrameType | None) -> None:
    for ending in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, signal.SIG_IGN)  # a second one must not interrupt the cleaning up
    _interrupt(number, frame)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    if not callbacks.is_within(frame):
        _raise(number)


def _raise(number: int) -> NoReturn:
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(128 + number)
