"""Reading tables of numbers from files."""

from __future__ import annotations

import gzip
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest

from egp_service import EgpError
from egp_service.data.table import numbers, read_table

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


def test_columns_of_other_types_are_read_or_an_error_in_words(tmp_path: Path) -> None:
    texts = pl.Series("speed", ["15.5", "16", "15.5"])
    enum = pl.Enum(["15.5", "16"])
    for column in (texts, texts.cast(pl.Categorical), texts.cast(enum)):
        assert numbers(tmp_path, column).tolist() == [15.5, 16.0, 15.5]
    words = pl.Series("speed", ["fast", "slow"]).cast(pl.Categorical)
    with pytest.raises(EgpError, match=r"column 'speed', row 0 holds 'fast', and 1 others"):
        numbers(tmp_path, words)
    with pytest.raises(EgpError, match="column 'speed' holds Binary, expected numbers"):
        numbers(tmp_path, pl.Series("speed", [b"15.5"]))


def test_points_in_time_may_be_texts(tmp_path: Path) -> None:
    for texts in (
        ["2026-11-24T10:15:30.00", "2026-11-24T10:15:30.02", "2026-11-24T10:15:31"],
        ["2026-11-24 10:15:30.000Z", "2026-11-24 10:15:30.020Z", "2026-11-24 10:15:31.000Z"],
    ):
        found = numbers(tmp_path, pl.Series("t", texts))
        assert found == pytest.approx([0.0, 0.02, 1.0], abs=1e-9)
    with pytest.raises(EgpError, match="row 1 holds 'later'"):
        numbers(tmp_path, pl.Series("t", ["2", "later"]))


def test_a_comment_above_numbers_is_the_header_if_it_names_each_column(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    rows = np.array([[0.0, 15.0], [0.02, 15.1], [0.04, 15.3]])
    for separator in (",", ";"):
        header = f"t{separator}speed"
        np.savetxt(path, rows, "%.9g", separator, header=header)  # after "# "
        assert path.read_text().startswith(f"# t{separator}speed\n0{separator}15\n")
        found = read_table(path)
        assert found.columns == ["t", "speed"]
        np.testing.assert_array_equal(found.to_numpy(), rows)
    np.savetxt(path, rows, "%.9g", ",", header="by a logger\nt,speed")
    assert read_table(path).columns == ["t", "speed"]
    assert len(read_table(path)) == 3


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("# by a logger\n0,15\n0.02,15.1\n", ["0", "15"]),
        ("# t,speed,yaw\n0,15\n0.02,15.1\n", ["0", "15"]),
        ("# t,\n0,15\n0.02,15.1\n", ["0", "15"]),
        ("# s,m/s\nt,speed\n0,15\n", ["t", "speed"]),
        ("# t,speed\n# s,m/s,\ntime,v\n0,15\n", ["time", "v"]),
    ],
)
def test_other_comments_stay_comments(tmp_path: Path, text: str, columns: list[str]) -> None:
    path = tmp_path / "drive.csv"
    path.write_text(text)
    found = read_table(path)
    assert found.columns == columns
    assert len(found) == 1
