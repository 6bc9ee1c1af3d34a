"""The threads of zenoh, which an environment variable sets for the whole process.

Closing the link to a silent process blocks a thread that receives for 30 to 50 ms. zenoh has two,
so that answers of healthy replicas come late meanwhile. Eight are therefore the default.

zenoh lets two threads write and read one connection of TLS at the same time, which ends links and
can damage the memory (issue 2557 of zenoh). A process whose first session uses TLS therefore sends
and receives with one thread; a router does not, because one that passes a large message on would
wait for itself.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Final

_VARIABLE: Final = "ZENOH_RUNTIME"
_EIGHT_RECEIVE: Final = "(rx: (worker_threads: 8))"
_ONE_FOR_BOTH: Final = "(rx: (handover: tx), tx: (worker_threads: 1))"


def use_default() -> None:
    """Let zenoh receive with eight threads, unless the variable states them."""
    os.environ.setdefault(_VARIABLE, _EIGHT_RECEIVE)


def use_for(*configuration: str) -> None:
    """Choose the threads for a session with these texts as its configuration.

    zenoh reads the variable when it opens the first session of a process; a later call has no
    effect. What the user stated stays.
    """
    if os.environ.get(_VARIABLE) == _EIGHT_RECEIVE and any("tls/" in it for it in configuration):
        os.environ[_VARIABLE] = _ONE_FOR_BOTH


def use_for_service(configuration: str, zenoh_file: object) -> None:
    """Choose the threads for a service with this configuration, which may name a file of zenoh.

    A file that cannot be read is an error of the service.
    """
    text = ""
    if isinstance(zenoh_file, str) and Path(zenoh_file).is_file():
        with suppress(OSError):
            text = Path(zenoh_file).read_text(encoding="utf-8", errors="replace")
    use_for(configuration, text)
