"""The examples in the extension's documentation run as they stand."""

from __future__ import annotations

import ast
import doctest
from pathlib import Path

import pytest

import egp_service

STUB = Path(egp_service.__file__).with_name("_core.pyi")
EXAMPLES = {
    node.name: text
    for node in ast.walk(ast.parse(STUB.read_text(encoding="utf-8")))
    if isinstance(node, ast.FunctionDef) and ">>>" in (text := ast.get_docstring(node) or "")
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_example(name: str) -> None:
    test = doctest.DocTestParser().get_doctest(EXAMPLES[name], {}, name, str(STUB), 0)
    assert doctest.DocTestRunner().run(test).failed == 0


def test_what_others_check_us_with_has_an_example() -> None:
    assert set(EXAMPLES) >= {"solve_ocp", "solve_weights", "predict"}
