"""A library of one member predicts the same as this member in the library that it came from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from egp_service._core import Library, LibraryError, write_library_subset
from library_example import write_example

if TYPE_CHECKING:
    from pathlib import Path


def test_a_member_alone_is_the_same_bit_for_bit(tmp_path: Path) -> None:
    whole, single = tmp_path / "whole.safetensors", tmp_path / "single.safetensors"
    write_example(whole)
    write_library_subset(whole, single, [1])
    library, alone = Library.load(whole), Library.load(single)
    assert [member.label for member in alone.members] == [library.members[1].label]
    assert alone.provenance["subset_of"] == library.id
    z = np.array([[15.0, 0.1, 0.2, 0.05, 1000.0, 0.1]])
    for here, there in zip(alone.predict(z), library.predict(z, member=1), strict=True):
        np.testing.assert_array_equal(here, there)


def test_a_member_that_is_not_there_is_refused(tmp_path: Path) -> None:
    whole = tmp_path / "whole.safetensors"
    write_example(whole)
    with pytest.raises(LibraryError, match="the library has 2") as refusal:
        write_library_subset(whole, tmp_path / "none.safetensors", [2])
    assert refusal.value.code == "no_member"
    assert not (tmp_path / "none.safetensors").exists()
