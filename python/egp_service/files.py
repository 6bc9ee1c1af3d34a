"""Atomic writing of files: a temporary file is renamed when it is complete; locks of folders."""

from __future__ import annotations

import errno
import fcntl
import os
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`; the file there replaces `path` at the end.

    Folders that are missing are made.

    Raises:
        OSError: naming `path`, not the temporary file, if `path` is a folder or cannot be written.

    """
    if path.is_dir():
        message = "this is a folder; name a file in it, or a new file"
        raise IsADirectoryError(errno.EISDIR, message, str(path))
    temporary = f".{path.name}."
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=temporary, dir=path.parent) as folder:
            beside = Path(folder) / path.name
            yield beside
            beside.replace(path)
    except OSError as error:
        if error.filename is not None and temporary in str(error.filename):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Wait until no other process is within this context with a folder.

    One that is missing is made, for its owner alone.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically.

    Raises:
        OSError: as for `replacing`.

    """
    with replacing(path) as beside:
        beside.write_text(text, encoding="utf-8")
