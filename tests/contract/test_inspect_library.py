"""`egp inspect` shows the content of the file."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from egp_service import shipped
from egp_service._core import Library
from egp_service.cli.inspect_library import inspect
from egp_service.evaluation import baselines
from library_example import write_example

if TYPE_CHECKING:
    from pathlib import Path


def test_inspect_shows_surfaces_sizes_scales_and_identity(tmp_path: Path) -> None:
    path = tmp_path / "library.safetensors"
    noise = np.array([0.0071, 0.0017, 0.0008])
    write_example(path, measurement_noise=noise, measurement_delay=0.056)
    library = Library.load(path)
    console = Console(file=io.StringIO(), width=200)
    inspect(path, console)
    assert isinstance(console.file, io.StringIO)
    text = console.file.getvalue()
    member = library.members[1]
    expected = [
        library.id,
        "0.05 s",
        "0.0071, 0.0017, 0.0008",
        "0.056 s",
        "rbf",
        "friction 1.1",
        "30",
        f"{member.lengthscales[2, 3]:.3g}",
        f"{member.envelope[1, 4]:.4g}",
        f"{member.noise_std[0]:.2g}",
    ]
    assert [value for value in expected if value not in text] == []


def test_inspect_shows_brackets_of_a_path(tmp_path: Path) -> None:
    (tmp_path / "[").mkdir()
    library = tmp_path / "[" / "mu].safetensors"
    write_example(library)
    console = Console(file=io.StringIO(), width=300)
    inspect(library, console)
    assert isinstance(console.file, io.StringIO)
    assert f"{library} (" in console.file.getvalue()


def test_inspect_shows_the_vehicle_of_a_member_without_gps(tmp_path: Path) -> None:
    path = tmp_path / "library.safetensors"
    baselines.write(path, "kinematic", shipped.DEMO_LIBRARY, [0, 1], 1)
    console = Console(file=io.StringIO(), width=200)
    inspect(path, console)
    assert isinstance(console.file, io.StringIO)
    text = console.file.getvalue()
    assert all(f"{value:.4g}" in text for value in baselines.kinematic(1))
