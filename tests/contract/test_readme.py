"""The README's Python example runs as it stands, with the shipped library in its place."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from typer.main import get_command

from egp_service.cli import app
from egp_service.simulation.scenario import library_path, load_scenario

README = Path(__file__).parents[2] / "README.md"


def test_the_example_drives() -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    library = library_path(load_scenario("rounded-rectangle"))
    assert '"library.safetensors"' in example
    names: dict[str, object] = {}
    exec(example.replace('"library.safetensors"', repr(str(library))), names)  # noqa: S102
    step, path, car = names["step"], names["path"], names["car"]
    assert step.mode == "normal"  # type: ignore[attr-defined]
    position = car.vehicle_state[:2]  # type: ignore[attr-defined]
    assert abs(path.project(np.array(position)).lateral) < 0.3  # type: ignore[attr-defined]


def test_every_command_it_names_exists() -> None:
    text = README.read_text(encoding="utf-8")
    known = set(get_command(app).commands)  # type: ignore[attr-defined]
    named = set(re.findall(r"\begp ([a-z]+)", text))
    assert named <= known
    assert {"collect", "train", "drive", "serve", "evaluate"} <= named
    makefile = (README.parent / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"`make ([a-z]+)`", text):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
