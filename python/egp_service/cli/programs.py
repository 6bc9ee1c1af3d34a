"""Programs of the extension that are commands of their own."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

PASS_ON: Final = {"allow_extra_args": True, "ignore_unknown_options": True}
"""Settings of a command that hands all options over to a program."""

_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def run_program(program: Callable[[Sequence[str]], int], arguments: Sequence[str]) -> int:
    """Run a program of the extension and return its exit code.

    Meanwhile a signal ends the process at once, or, where the program reports what it has until
    then, with the program: Python's handlers would wait for the program to return.
    """
    handlers = {
        number: signal.signal(number, signal.SIG_DFL)
        for number in _ENDING
        if signal.getsignal(number) != signal.SIG_IGN
    }
    try:
        return program(arguments)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
