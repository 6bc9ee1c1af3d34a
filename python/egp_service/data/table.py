"""Tables of numbers: Parquet files, and CSV files as several countries write them."""

from __future__ import annotations

import contextlib
import csv
import gzip
import io
import zlib
from typing import TYPE_CHECKING, Final

import numpy as np
import polars as pl

from egp_service._core import EgpError
from egp_service.files import read_bytes

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

_SEPARATORS: Final = (";", "\t")
_GZIP: Final = b"\x1f\x8b"  # the first bytes of a compressed file (RFC 1952)
_DECIMAL_COMMA: Final = r"^\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*$"
_TIME: Final = r"^\s*\d{4}-\d\d-\d\d[T ]\d\d:"
_MOST_NAMES: Final = 20
# What follows the name of a column that another one has, too; then comes its place from 1 on.
_PLACE: Final = " (column "

UNREADABLE: Final = (pl.exceptions.PolarsError, pl.exceptions.PanicException)
"""What polars raises for a damaged file; the second is no `Exception`."""


def read_table(path: Path, separator: str = ",") -> pl.DataFrame:
    """Read a Parquet file (`.parquet`) or a CSV file, which may be compressed by gzip.

    In CSV files lines that begin with `#` are comments, and a byte-order mark is left out. A
    comment is the header, as `numpy.savetxt` writes it, if numbers follow in the next line, one for
    each of its names. If the header has no `separator` but semicolons or tabs, those separate.
    Columns of one name get their places behind it.

    Raises:
        EgpError: naming the file, if there is none, if it cannot be read or is no Parquet or CSV
            file, or if a line of a CSV file has more fields than the header.

    """
    if not path.is_file():
        raise EgpError(f"{path}: no such file")
    content = read_bytes(path)
    if path.suffix.lower() == ".parquet":
        try:
            return pl.read_parquet(io.BytesIO(content))
        except UNREADABLE as error:
            raise EgpError(f"{path}: not a readable Parquet file ({error})") from error
    try:
        if content.startswith(_GZIP):
            content = gzip.decompress(content)
        text = content.decode("utf-8-sig")
        if "\r" in text and "\n" not in text:
            raise EgpError(f"{path}: lines end with CR only: save the file with LF or CR LF")
        lines = text.splitlines()
        header, separator, first = _header(lines, separator)
        if first > 0:
            content = "\n".join([header, *lines[first:]]).encode()
        # The names as they are written; polars changes one that comes twice.
        columns = [name.strip() for name in next(csv.reader([header], delimiter=separator))]
        frame = pl.read_csv(
            content, separator=separator, comment_prefix="#", infer_schema_length=None
        )
    except (UnicodeDecodeError, csv.Error, OSError, EOFError, zlib.error) as error:
        raise EgpError(f"{path}: not a readable CSV file ({error})") from error
    except pl.exceptions.PolarsError as error:
        with contextlib.suppress(csv.Error):
            _check_fields(path, lines, len(columns), separator)
        raise EgpError(f"{path}: not a readable CSV file ({error})") from error
    names = [name.removeprefix("\ufeff") for name in frame.columns]
    if len(columns) == len(names):
        names = [
            f"{column}{_PLACE}{place})" if column and columns.count(column) > 1 else name
            for place, (name, column) in enumerate(zip(names, columns, strict=True), 1)
        ]
    frame.columns = [name.strip() or name for name in names]
    return frame


def _header(lines: Sequence[str], separator: str) -> tuple[str, str, int]:
    """Return the header and its separator; if it is a comment, also the first line below it."""
    first = next((i for i, line in enumerate(lines) if line and line[0] != "#"), 0)
    header = lines[first] if lines else ""
    if separator not in header:
        separator = next((other for other in _SEPARATORS if other in header), separator)
    if first > 0 and _are_names(lines[first - 1], header, separator):
        return lines[first - 1].lstrip("# "), separator, first
    return header, separator, 0


def _are_names(comment: str, row: str, separator: str) -> bool:
    """Return whether a comment has a name for each cell of the row below it, all numbers."""
    cells = row.split(separator)
    try:
        for cell in cells:
            float(cell)
    except ValueError:
        return False
    names = comment.removeprefix("#").split(separator)
    return len(names) == len(cells) and all(name.strip() for name in names)


def _check_fields(path: Path, lines: Sequence[str], expected: int, separator: str) -> None:
    """Errors if a line has more fields than expected."""
    for number, line in enumerate(lines, 1):
        count = len(next(csv.reader([line], delimiter=separator), []))
        if count > expected and line[0] != "#":
            raise EgpError(
                f"{path}: line {number} has {count} fields and the header {expected}: correct or "
                "remove this line"
            )


def comes_twice(name: str, names: Sequence[str]) -> bool:
    """Return whether two columns of a file had this name, which `read_table` has told apart."""
    return any(other.startswith(name + _PLACE) for other in names)


def some(names: Sequence[str]) -> str:
    """Return the names of columns for a message, the first 20 if there are more."""
    more = f" and {len(names) - _MOST_NAMES} others" if len(names) > _MOST_NAMES else ""
    return ", ".join(name or repr("") for name in names[:_MOST_NAMES]) + more


def numbers(path: Path, column: pl.Series) -> NDArray[np.float64]:
    """Return a column's numbers; with a decimal comma if all cells have one or are whole.

    Points in time, also in texts as `2026-11-24T10:15:30.25`, are seconds since the first one, and
    durations are seconds.

    Raises:
        EgpError: naming column, row and content of the first cell that is no finite number. Rows
            are counted from 0 behind the header.

    """
    cells = column
    if isinstance(column.dtype, pl.Categorical | pl.Enum):
        column = cells = column.cast(pl.String)
    if column.dtype == pl.String and column.str.contains(_TIME).all():
        texts = column.str.strip_chars().str.strip_suffix("Z")
        with contextlib.suppress(pl.exceptions.PolarsError):
            column = cells = texts.str.to_datetime(time_unit="ns")
    if isinstance(column.dtype, pl.Datetime):
        stated = column.drop_nulls()
        if len(stated) > 0:
            cells = (column - stated[0]).dt.total_nanoseconds() * 1e-9
    elif isinstance(column.dtype, pl.Duration):
        cells = column.dt.total_nanoseconds() * 1e-9
    elif column.dtype.is_nested() or column.dtype == pl.Binary:
        raise EgpError(f"{path}: column '{column.name}' holds {column.dtype}, expected numbers")
    elif column.dtype == pl.String:
        if (
            column.str.contains(_DECIMAL_COMMA).any()
            and not column.str.contains(".", literal=True).any()
        ):
            cells = column.str.replace(",", ".", literal=True)
        cells = cells.str.strip_chars()
    values = cells.cast(pl.Float64, strict=False).to_numpy()
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        row = int(bad[0])
        content = column[row]
        found = "is empty" if content in {None, ""} else f"holds {content!r}"
        more = f", and {len(bad) - 1} others" if len(bad) > 1 else ""
        raise EgpError(
            f"{path}: column '{column.name}', row {row} {found}{more}: expected finite "
            "numbers; correct or remove these rows"
        )
    return values
