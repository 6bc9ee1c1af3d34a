"""Tables that are nearly right: the error names line, row or column."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl
import pytest
from plant_log import COLUMNS, MASS, plant_log
from surfaces import provenance

from egp_service import EgpError
from egp_service.data.log_import import import_log
from egp_service.data.table import read_table

if TYPE_CHECKING:
    from pathlib import Path


def test_a_line_with_a_further_field_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("# by a logger\nt,v\n0,1\n\n1,2,3\n2,3\n")
    with pytest.raises(EgpError, match="line 5 has 3 fields and the header 2") as caught:
        read_table(path)
    assert "truncate" not in str(caught.value)


def test_two_columns_of_one_name_are_told_apart_by_their_places(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text('t;"speed";speed\n0;1;2\n')
    assert read_table(path).columns == ["t", "speed (column 2)", "speed (column 3)"]
    path.write_text("t,v,,\n0,1,,\n")  # columns without a name are not used
    assert read_table(path).columns[:2] == ["t", "v"]


def test_lines_that_end_with_cr_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(b"t,v\r0,1\r1,2\r")
    with pytest.raises(EgpError, match="lines end with CR only"):
        read_table(path)


def test_not_every_name_of_a_wide_table_is_shown(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(",".join(f"c{number}" for number in range(50)) + "\n")
    with pytest.raises(EgpError, match=r"has the columns c0, .*, c19 and 30 others$"):
        import_log(path, {}, provenance())
    with pytest.raises(EgpError, match=r"no column 'time', found c0, .*, c19 and 30 others$"):
        import_log(path, COLUMNS, provenance(), mass=MASS)


def test_a_parquet_file_may_be_named_in_capitals(tmp_path: Path) -> None:
    path = tmp_path / "LOG.PARQUET"
    pl.DataFrame({"t": [0.0, 1.0]}).write_parquet(path)
    assert read_table(path)["t"].to_list() == [0.0, 1.0]


def test_single_values_that_are_too_large_are_no_wrong_unit(tmp_path: Path) -> None:
    path, log = tmp_path / "log.csv", plant_log()
    log["v_x"][[500, 700]] = 9999.0
    pl.DataFrame(log).write_csv(path)
    with pytest.raises(EgpError, match="at row 500 of 'v_x', and 1 other row") as caught:
        import_log(path, COLUMNS, provenance(dt=0.02), mass=MASS)
    assert "unit" not in str(caught.value)


@pytest.mark.parametrize("mass", [float("nan"), 0.0, -1.0, float("inf")])
def test_a_mass_is_a_positive_number(tmp_path: Path, mass: float) -> None:
    path = tmp_path / "log.csv"
    pl.DataFrame(plant_log()).write_csv(path)
    with pytest.raises(EgpError, match="expected a --mass of 1 to 100000 kg, got"):
        import_log(path, COLUMNS, provenance(dt=0.02), mass=mass)
