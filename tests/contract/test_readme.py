"""The documents' Python examples run as they stand, and the commands that documents name exist.

The shipped library takes the place of the examples' library file.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from egp_service.cli import app
from egp_service.simulation.scenario import library_path, load_scenario

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])


def run_examples(document: Path) -> list[dict[str, object]]:
    """Run a document's Python examples; the names of each."""
    text = document.read_text(encoding="utf-8")
    library = library_path(load_scenario("rounded-rectangle"))
    found = []
    for example in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        assert '"library.safetensors"' in example
        names: dict[str, object] = {}
        exec(example.replace('"library.safetensors"', repr(str(library))), names)  # noqa: S102
        found.append(names)
    return found


def test_the_readmes_example_steers_back_to_the_reference() -> None:
    (names,) = run_examples(README)
    step = names["step"]
    assert step.mode == "normal"  # type: ignore[attr-defined]
    # The car is left of the reference.
    assert step.u[1] < 0.0  # type: ignore[attr-defined]
    assert step.plan_x[-1, 1] < 0.1  # type: ignore[attr-defined]


def test_the_laps_drive() -> None:
    told, untold = run_examples(ROOT / "docs/python.md")
    for names in (told, untold):
        step, path, car = names["step"], names["path"], names["car"]
        assert step.mode == "normal"  # type: ignore[attr-defined]
        position = car.vehicle_state[:2]  # type: ignore[attr-defined]
        assert abs(path.project(np.array(position)).lateral) < 0.3  # type: ignore[attr-defined]
    found = untold["found"]
    assert found.lower < 0.5 < found.upper  # type: ignore[attr-defined]
    line = repr(untold["step"])
    assert len(line) < 120
    assert "normal, solved" in line
    assert f"friction {found.lower:.2f} to {found.upper:.2f}" in line  # type: ignore[attr-defined]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.name)
def test_every_command_it_names_exists(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    known = set(get_command(app).commands)  # type: ignore[attr-defined]
    named = set(re.findall(r"\begp ([a-z0-9]+)", text))
    assert named <= known
    if document == README:
        assert {"collect", "train", "drive", "serve", "evaluate"} <= named
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"`make ([a-z-]+)`", text):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
