"""The dataset file: written data can be read, and errors name the problem."""

from __future__ import annotations

import dataclasses
import json
import os
import resource
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
import pytest
from surfaces import provenance, surface

from egp_service import EgpError
from egp_service.data.dataset import METADATA_KEY, Dataset, merge
from egp_service.data.experiment import Experiment
from egp_service.data.table import read_table

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from egp_service.data.provenance import Provenance


def test_comes_back_bit_for_bit(tmp_path: Path) -> None:
    written = surface()
    written.write(tmp_path / "wet.parquet")
    read = Dataset.read(str(tmp_path / "wet.parquet"))
    assert read.provenance == written.provenance
    assert read.digest() == written.digest()
    assert [path.name for path in tmp_path.iterdir()] == ["wet.parquet"]


def test_a_file_may_have_a_name_that_is_not_utf_8(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"\xff.parquet")
    surface().write(path)
    assert os.listdir(os.fsencode(tmp_path)) == [b"\xff.parquet"]  # noqa: PTH208 - bytes
    assert Dataset.read(path).digest() == surface().digest()
    assert len(read_table(path)) == len(surface())


def test_a_full_disk_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    path, before = tmp_path / "wet.parquet", resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, before[1]))
    try:
        with pytest.raises(OSError, match=r"wet\.parquet"):
            surface().write(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("label", "complaint"),
    [
        ("", "the surface label is empty"),
        ("wet\n", "has a control character"),
        ("\x1b[31mwet", "has a control character"),
        ("wet\udcff", "or one that is not UTF-8"),
        ("x" * 65, "has 65 characters: expected at most 64"),
    ],
)
def test_a_label_is_one_short_line(label: str, complaint: str) -> None:
    for sound in ("Schnee, gefegt", "雪", "x" * 64, "[bold]wet", "mu 0.5"):
        assert provenance(surface=sound).surface == sound
    with pytest.raises(EgpError, match=complaint):
        provenance(surface=label)
    with pytest.raises(EgpError, match=complaint):
        Experiment(0.5, label)


def test_metadata_name_units_and_origin(tmp_path: Path) -> None:
    surface().write(tmp_path / "wet.parquet")
    metadata = json.loads(pl.read_parquet_metadata(tmp_path / "wet.parquet")[METADATA_KEY])
    assert metadata["units"]["F_x"] == "N"
    assert metadata["units"]["d_omega"] == "rad/s"
    assert metadata["surface"] == "mu 0.5"
    assert metadata["dt"] == 0.05
    assert metadata["schema"] == 1


def test_digest_sees_a_single_bit() -> None:
    dataset = surface()
    z = dataset.z.copy()
    z[3, 2] = np.nextafter(z[3, 2], 1.0)
    assert dataclasses.replace(dataset, z=z).digest() != dataset.digest()


@pytest.mark.parametrize("wrong", [-1, 2**32, 0.5])
def test_numbers_of_trajectories_are_not_changed_silently(tmp_path: Path, wrong: float) -> None:
    dataset = surface()
    numbers = dataset.trajectory.astype(type(wrong))
    numbers[3] = wrong
    with pytest.raises(EgpError, match="trajectory"):
        dataclasses.replace(dataset, trajectory=numbers)
    file = tmp_path / "wet.parquet"
    dataset.write(file)
    metadata = pl.read_parquet_metadata(file)
    frame = pl.read_parquet(file).with_columns(trajectory=pl.Series(numbers))
    frame.write_parquet(file, metadata={METADATA_KEY: metadata[METADATA_KEY]})
    with pytest.raises(EgpError, match=r"wet\.parquet.*trajectory"):
        Dataset.read(file)


def test_merging_nothing_is_an_error() -> None:
    with pytest.raises(EgpError, match="at least one dataset"):
        merge([])


def test_merging_keeps_trajectories_apart() -> None:
    first, second = surface(seed=1, trajectories=3), surface(seed=2, trajectories=4)
    merged = merge([first, second])
    assert len(merged) == len(first) + len(second)
    assert len(np.unique(merged.trajectory)) == 7


@pytest.mark.parametrize(
    "other",
    [
        provenance(dt=0.1),
        provenance(vehicle="other"),
        provenance(surface="other"),
        provenance(0.6, surface="mu 0.5"),
    ],
)
def test_merging_refuses_what_differs(other: Provenance) -> None:
    with pytest.raises(EgpError, match=r"cannot merge: (dt|vehicle|surface|friction)"):
        merge([surface(), dataclasses.replace(surface(), provenance=other)])


def _rewrite(
    path: Path, change: Callable[[pl.DataFrame], pl.DataFrame], **metadata: object
) -> None:
    """Write a valid file with changed columns and metadata."""
    surface().write(path)
    fields = json.loads(pl.read_parquet_metadata(path)[METADATA_KEY]) | metadata
    frame = change(pl.read_parquet(path))
    frame.write_parquet(path, metadata={METADATA_KEY: json.dumps(fields)})


def test_refuses_bad_columns_and_values(tmp_path: Path) -> None:
    path = tmp_path / "wet.parquet"
    changes: dict[str, Callable[[pl.DataFrame], pl.DataFrame]] = {
        "column omega is missing": lambda frame: frame.drop("omega"),
        "column step is missing": lambda frame: frame.drop("step"),
        "column v_x is String": lambda frame: frame.cast({"v_x": pl.String}),
        "column step is Float64": lambda frame: frame.cast({"step": pl.Float64}),
        "column F_x has 1 empty": lambda frame: frame.with_columns(
            pl.when(pl.int_range(pl.len()) == 5).then(None).otherwise("F_x").alias("F_x")
        ),
        "column d_v_y, row 5 is nan": lambda frame: frame.with_columns(
            pl.when(pl.int_range(pl.len()) == 5)
            .then(float("nan"))
            .otherwise("d_v_y")
            .alias("d_v_y")
        ),
        "empty": lambda frame: frame.head(0),
    }
    for message, change in changes.items():
        _rewrite(path, change)
        with pytest.raises(EgpError, match=message) as refusal:
            Dataset.read(path)
        assert str(path) in str(refusal.value)


def test_refuses_bad_metadata(tmp_path: Path) -> None:
    path = tmp_path / "wet.parquet"
    metadata: dict[str, dict[str, object]] = {
        "dataset schema 2": {"schema": 2},
        "units are": {"units": {"v_x": "km/h"}},
        "metadata keys": {"colour": "red"},
        "dt is 50": {"dt": 50.0},
        "friction is -1": {"friction": -1.0},
        "dt is '0.05' in the metadata: expected a number": {"dt": "0.05"},
        "friction is None in the metadata": {"friction": None},
        "seed is 0.5 in the metadata: expected a whole number": {"seed": 0.5},
        "surface is 3 in the metadata: expected a text": {"surface": 3},
    }
    for message, fields in metadata.items():
        _rewrite(path, lambda frame: frame, **fields)
        with pytest.raises(EgpError, match=message):
            Dataset.read(path)


def test_frictions_are_those_of_surfaces() -> None:
    assert provenance(3.0).friction == 3.0
    for friction in (0.0, 3.01, float("nan")):
        with pytest.raises(EgpError, match="expected a coefficient above 0 and at most 3"):
            provenance(friction)


def test_metadata_that_are_no_object_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "wet.parquet"
    pl.DataFrame({"v_x": [1.0]}).write_parquet(path, metadata={METADATA_KEY: "[1]"})
    with pytest.raises(EgpError, match="metadata are a list: expected an object"):
        Dataset.read(path)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    for name in ("own.parquet", "own.csv"):
        path = tmp_path / name
        path.symlink_to("/proc/self/mem")  # a regular file, of which a read at its start fails
        for read in (Dataset.read, read_table):
            with pytest.raises(EgpError, match=rf"{name}: Input/output error"):
                read(path)


def test_refuses_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(EgpError, match="no such file"):
        Dataset.read(tmp_path / "none.parquet")
    (tmp_path / "text.parquet").write_text("v_x,v_y")
    with pytest.raises(EgpError, match="not a readable Parquet"):
        Dataset.read(tmp_path / "text.parquet")
    pl.DataFrame({"v_x": [1.0]}).write_parquet(tmp_path / "bare.parquet")
    with pytest.raises(EgpError, match="--from-log"):
        Dataset.read(tmp_path / "bare.parquet")


def test_a_damaged_file_at_which_polars_panics_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def panic(_: object) -> None:
        raise pl.exceptions.PanicException("index out of bounds")

    (tmp_path / "a.parquet").touch()
    monkeypatch.setattr(pl, "read_parquet_metadata", panic)
    monkeypatch.setattr(pl, "read_parquet", panic)
    for read in (Dataset.read, read_table):
        with pytest.raises(EgpError, match=r"a\.parquet: not a readable Parquet file \(index out"):
            read(tmp_path / "a.parquet")


def test_files_say_that_the_mass_was_assumed(tmp_path: Path) -> None:
    path = tmp_path / "wet.parquet"
    surface().write(path)
    # As files of older versions, which do not state it.
    assert "force_from_a_x" not in json.loads(pl.read_parquet_metadata(path)[METADATA_KEY])
    assert not Dataset.read(path).provenance.force_from_a_x
    assumed = dataclasses.replace(surface(seed=1), provenance=provenance(force_from_a_x=True))
    assumed.write(path)
    assert Dataset.read(path).provenance.force_from_a_x
    assert merge([surface(), assumed]).provenance.force_from_a_x
    _rewrite(path, lambda frame: frame, force_from_a_x=1)
    with pytest.raises(EgpError, match="force_from_a_x is 1 in the metadata: expected true or"):
        Dataset.read(path)


def test_merging_refuses_the_same_transitions(tmp_path: Path) -> None:
    surface().write(tmp_path / "wet.parquet")
    again = Dataset.read(tmp_path / "wet.parquet")
    with pytest.raises(EgpError, match=r"numbers 1 and 3 of the datasets .*'mu 0.5'.* same trans"):
        merge([surface(), surface(seed=1), again])
