"""Examples in docstrings run, and `help()` shows what the extension's stubs say."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
from operator import attrgetter
from pathlib import Path

import pytest

import egp_service
from egp_service import _core


def documented(node: ast.AST, prefix: str = "") -> dict[str, str]:
    """Find the docstrings of classes, functions and methods by their dotted names."""
    found = {}
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef | ast.FunctionDef):
            if text := ast.get_docstring(child):
                found[prefix + child.name] = text
            found |= documented(child, f"{prefix}{child.name}.")
    return found


PACKAGE = Path(egp_service.__file__).parent
STUBS = PACKAGE.joinpath("_core").glob("*.pyi")
DOCS = {
    name: text
    for stub in STUBS
    for name, text in documented(ast.parse(stub.read_text(encoding="utf-8"))).items()
}


def test_help_shows_the_documentation_of_the_stubs() -> None:
    assert {name: inspect.getdoc(attrgetter(name)(_core)) for name in DOCS} == DOCS


# Modules of the package with an example in a docstring.
MODULES = [
    ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts)
    for file in sorted(PACKAGE.rglob("*.py"))
    if ">>> " in file.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("name", [name for name, text in DOCS.items() if ">>>" in text])
def test_example(name: str) -> None:
    test = doctest.DocTestParser().get_doctest(DOCS[name], {}, name, None, 0)
    assert test.examples
    assert doctest.DocTestRunner().run(test) == (0, len(test.examples))


@pytest.mark.parametrize("name", MODULES)
@pytest.mark.filterwarnings("ignore:.*Box observation space:UserWarning")
def test_examples_of_a_module(name: str) -> None:
    failed, attempted = doctest.testmod(importlib.import_module(name))
    assert attempted
    assert not failed
