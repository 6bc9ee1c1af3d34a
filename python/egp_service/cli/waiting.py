"""What a command says while it waits for a service."""

from __future__ import annotations

import threading
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

import typer

from egp_service.control.endpoints import endpoint_names, why_unreachable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_QUIET_SECONDS: Final = 1.0


@contextmanager
def waiting(
    what: str, endpoints: Sequence[str], seconds: float, *, unless_reachable: bool = False
) -> Iterator[None]:
    """Say on stderr what is waited for if the block takes longer than a second.

    `seconds` is the longest time that it waits; without endpoints it waits at those of a file. With
    `unless_reachable` nothing is said if there are no endpoints, or if a program may accept
    connections at one of them, because the block then takes longer for another reason.
    """

    def tell() -> None:
        if unless_reachable and not (endpoints and all(map(why_unreachable, endpoints))):
            return
        where = endpoint_names(endpoints)
        with suppress(OSError):  # the terminal may have gone
            typer.echo(f"waiting up to {seconds:g} s for {what} at {where}", err=True)

    timer = threading.Timer(_QUIET_SECONDS, tell)
    timer.daemon = True
    if seconds > _QUIET_SECONDS:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
