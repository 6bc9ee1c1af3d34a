"""What the command line writes: its standard output, and warnings."""

from __future__ import annotations

import io
import os
import sys
import warnings
from typing import TYPE_CHECKING, TextIO

import typer

from egp_service._core import EgpError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer
    from rich.console import Console


class _StandardOutput(io.FileIO):
    """A file whose write errors, such as that of a full disk, are an `EgpError` that says so."""

    def write(self, data: ReadableBuffer, /) -> int:
        """Write as other files do; that a pipe has no reader any more stays its own error."""
        try:
            return super().write(data)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise EgpError(f"cannot write to the standard output: {error.strerror}") from error


def install() -> None:
    """Write the standard output in this way, with `?` for characters its encoding does not have."""
    out = sys.stdout
    if not isinstance(out, io.TextIOWrapper):  # it was closed
        return
    raw = _StandardOutput(out.fileno(), "wb", closefd=False)
    sys.stdout = io.TextIOWrapper(
        raw if out.write_through else io.BufferedWriter(raw),
        encoding=out.encoding,
        errors="replace",
        line_buffering=out.line_buffering,
        write_through=out.write_through,
    )


def say(console: Console, *lines: str, style: str | None = None) -> None:
    """Print lines as they are: brackets are no markup, and numbers have no colours of their own."""
    console.print(*lines, sep="\n", style=style, markup=False, highlight=False)


def show_own_warnings() -> None:
    """Show warnings of this package as other messages of the command line, without their place."""
    others = warnings.showwarning

    def show(  # noqa: PLR0917 - Python calls it so
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if category.__module__.partition(".")[0] == __package__.partition(".")[0]:
            typer.echo(f"egp: {message}", err=True)
        else:
            others(message, category, filename, lineno, file, line)

    warnings.showwarning = show


def discard() -> None:
    """Discard what could not be written, so that Python does not try it again when it ends."""
    if not isinstance(sys.stdout, io.TextIOWrapper):
        return
    try:
        sys.stdout.flush()
    except (EgpError, BrokenPipeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
