"""Names and reading of files; atomic writing: a complete temporary file is renamed; locks."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import stat
import tomllib
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from egp_service._core import EgpError

if TYPE_CHECKING:
    from collections.abc import Iterator


def file_name(text: str) -> str:
    """Return the text with a hyphen for what is no letter or digit, so that it names one file."""
    return re.sub(r"\W+", "-", text)


def destination(path: Path) -> Path:
    """Return where a file lies that is written as `path`: where its symbolic links lead.

    Raises:
        OSError: naming `path`, if it is a folder, a pipe, a socket or a device, or cannot be
            looked up.

    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return path.resolve()
    except NotADirectoryError:
        raise _in_the_place_of(path.parent) from None
    if stat.S_ISDIR(mode):
        message = "this is a folder; name a file in it, or a new file"
        raise IsADirectoryError(errno.EISDIR, message, str(path))
    if not stat.S_ISREG(mode):
        found = "a pipe" if stat.S_ISFIFO(mode) else "a socket or a device"
        message = f"expected a regular file or a new name, got {found}"
        raise OSError(errno.EINVAL, message, str(path))
    return path.resolve()


def make_folder(folder: Path, mode: int = 0o777) -> None:
    """Make a folder and those in which it lies, where they are missing.

    Raises:
        OSError: naming what is in the place of a folder, or the folder that cannot be made.

    """
    try:
        folder.mkdir(mode, parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise _in_the_place_of(folder) from None


def _in_the_place_of(folder: Path) -> NotADirectoryError:
    """Return the error that names the file in the place of a folder, or of one above it."""
    found = next(path for path in (folder, *folder.parents) if os.path.lexists(path))
    return NotADirectoryError(errno.ENOTDIR, "this is no folder; name another one", str(found))


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path; the file there replaces the one at `path` at the end.

    Where `path` is a symbolic link, the file to which it leads is replaced, and the link stays.
    The temporary file has the same name in a folder beside the one that it replaces, and is on the
    disk before it does so. Folders that are missing are made.

    Raises:
        OSError: naming `path`, not the temporary file, if no file can be written there, or if
            `path` is a folder, a pipe, a socket or a device.

    """
    target = destination(path)
    temporary = f".{target.name}."
    try:
        make_folder(target.parent)
        with TemporaryDirectory(prefix=temporary, dir=target.parent) as folder:
            beside = Path(folder) / path.name
            yield beside
            _sync(beside)
            beside.replace(target)
        _sync(target.parent)
    except OSError as error:
        # An error of a write, such as that of a full disk, names no file.
        unnamed = error.errno is not None and error.filename is None
        if unnamed or temporary in str(error.filename):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def _sync(path: Path) -> None:
    """Write a file, or the names in a folder, to the disk, so that a power failure keeps them."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Wait until no other process is within this context with a folder.

    One that is missing is made, for its owner alone.
    """
    make_folder(folder, 0o700)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """Read the text and the table of a TOML file.

    Raises:
        EgpError: naming the file, if it cannot be read or is not TOML.

    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise EgpError(f"{path}: expected a TOML file, got bytes that are no UTF-8 text") from error
    except (OSError, ValueError) as error:  # the latter for a path with the character NUL
        raise EgpError(f"{path}: {getattr(error, 'strerror', error)}") from error
    try:
        return text, tomllib.loads(text)
    except ValueError as error:  # also of a number with thousands of digits
        raise EgpError(f"{path} is not TOML: {error}") from error


def read_bytes(path: Path) -> bytes:
    """Read a file; raise `EgpError` naming it if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:  # that of a read, unlike that of opening a file, names no file
        raise EgpError(f"{path}: {error.strerror}") from error


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically; `OSError` as for `replacing`."""
    with replacing(path) as beside:
        beside.write_text(text, encoding="utf-8")
