"""Reading tables of numbers from files."""

from __future__ import annotations

import gzip
from typing import TYPE_CHECKING

import polars as pl
import pytest

from egp_service import EgpError
from egp_service.data.table import read_table

if TYPE_CHECKING:
    from pathlib import Path


def test_a_compressed_table_is_read_and_a_damaged_one_is_an_error(tmp_path: Path) -> None:
    plain, compressed = tmp_path / "drive.csv", tmp_path / "drive.csv.gz"
    written = pl.DataFrame({"t": range(500), "speed": [15.0 + 0.01 * k for k in range(500)]})
    written.write_csv(plain)
    content = gzip.compress(plain.read_bytes())
    compressed.write_bytes(content)
    assert read_table(compressed).equals(written)
    for damaged in (content[:-100], content[:20] + b"?" + content[21:], content[:2]):
        compressed.write_bytes(damaged)
        with pytest.raises(EgpError, match=r"drive\.csv\.gz: not a readable CSV file"):
            read_table(compressed)
