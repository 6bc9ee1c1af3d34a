"""Python examples of the documents run as they stand; the commands and options they name exist."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from typer.main import get_command

from egp_service.cli import app

if TYPE_CHECKING:
    from click import Command

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
COMMAND: Command = get_command(app)  # type: ignore[assignment] # Typer has its own copy of Click
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])


def run_examples(document: Path, count: int | None = None) -> list[dict[str, object]]:
    """Run a document's Python examples, or the first ones; the names of each."""
    text = document.read_text(encoding="utf-8")
    found = []
    for example in re.findall(r"```python\n(.*?)```", text, re.DOTALL)[:count]:
        names: dict[str, object] = {}
        exec(example, names)  # noqa: S102
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
    told, untold = run_examples(ROOT / "docs/python.md", 2)
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


def commands(text: str) -> list[str]:
    """Return the commands of `egp` in blocks and between backticks, without comments."""
    text = text.replace("\\\n", " ")
    in_blocks = re.findall(r"^egp [^\n#]+", text, re.MULTILINE)
    outside = re.sub(r"^ *```.*?^ *```$", "", text, flags=re.MULTILINE | re.DOTALL)
    return in_blocks + [" ".join(found.split()) for found in re.findall(r"`(egp [^`]+)`", outside)]


def unknown(command: str) -> list[str]:
    """Return those words of a command that are neither options of it nor what they are given."""
    words = shlex.split(command)[1:]
    inner = COMMAND
    if words[0].isupper():  # stands for any command
        return []
    while words and hasattr(inner, "commands") and not words[0].startswith("-"):
        if words[0] not in inner.commands:
            return [words[0]]
        inner = inner.commands[words.pop(0)]
    known = options(inner) | {"--help"}
    options_given = [word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)]
    return [word for word in options_given if word not in known]


def options(command: Command) -> set[str]:
    """Return the names of all options, of a program of the extension those that its help lists."""
    own = {name for parameter in command.params for name in parameter.opts}
    own |= {name for parameter in command.params for name in parameter.secondary_opts}
    return own | options_of_program(command.name) if command.name in {"load", "simulate"} else own


@cache
def options_of_program(name: str) -> set[str]:
    arguments = [sys.executable, "-m", "egp_service", name, "--", "--help"]
    text = subprocess.run(arguments, capture_output=True, text=True, check=True).stdout
    return set(re.findall(r"^ +(?:-\w, )?(--[a-z-]+)", text, re.MULTILINE))


def test_unknown_commands_and_options_are_found() -> None:
    assert unknown("egp drive -s random --no-pictures --plant=a:B") == []
    assert unknown("egp drive --scenery random") == ["--scenery"]
    assert unknown("egp vehicle fit --known car.toml -x 1") == ["-x"]
    assert unknown("egp vehicle guess") == ["guess"]
    assert unknown("egp simulate --seeds 0..3 --seedling 4") == ["--seedling"]
    assert commands("see `egp drive\n-s random`\n```sh\negp load \\\n  --json a # b\n```\n") == [
        "egp load    --json a ",
        "egp drive -s random",
    ]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.name)
def test_every_command_it_names_exists(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    known = set(COMMAND.commands)  # type: ignore[attr-defined]
    named = set(re.findall(r"\begp ([a-z0-9]+)", text))
    assert named <= known
    if document == README:
        assert {"collect", "train", "drive", "serve", "evaluate"} <= named
    for command in commands(text):
        assert unknown(command) == [], command
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"`make ([a-z-]+)`", text):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
