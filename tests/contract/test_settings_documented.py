"""`docs/settings.md` names every setting, with the default that the program has."""

from __future__ import annotations

import ast
import inspect
import itertools
import re
import tomllib
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import numpy as np
import pytest

from egp_service import SpeedProfile, shipped
from egp_service._core import EgpError, Engine, Gate, Server
from egp_service.simulation.scenario import Scenario

if TYPE_CHECKING:
    from collections.abc import Mapping

ROOT = Path(__file__).parents[2]
DOCUMENT = (ROOT / "docs/settings.md").read_text(encoding="utf-8")
# Settings that the control step does not write while they are not set, with a use of each.
UNSET = {
    "soft.envelope": "[soft]\nenvelope = [8.0, 2.0]",
    "weights.prior.alpha": '[weights.prior]\nkind = "l1"\nalpha = 1e-5',
}


def documented(section: str) -> dict[str, Any]:
    """Keys of a section with their defaults; a key without a default has `None`."""
    (text,) = re.findall(
        rf"^## \d+\. {section}\n(.*?)(?=^## |\Z)", DOCUMENT, re.MULTILINE | re.DOTALL
    )
    found: dict[str, Any] = {}
    for key, cell in re.findall(r"^\| `([\w.]+)` \| ([^|]*) \|", text, re.MULTILINE):
        assert key not in found, f"{key} is documented twice"
        value = re.match(r"`([^`]*)`", cell)
        assert value or cell.startswith("none"), f"{key}: {cell}"
        found[key] = tomllib.loads(f"value = {value[1]}")["value"] if value else None
    return found


def flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Name the values of a table by their dotted keys."""
    values: dict[str, Any] = {}
    for key, value in table.items():
        deeper = (
            flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
        )
        values.update(deeper)
    return values


def test_control_step() -> None:
    engine = Engine(str(shipped.DEMO_LIBRARY))
    assert engine.dt == pytest.approx(0.02)  # for which the document states horizon and window
    expected = flat(tomllib.loads(engine.settings_toml))
    assert documented("Control step") == expected | dict.fromkeys(UNSET)


@pytest.mark.parametrize("key", UNSET)
def test_settings_that_are_not_set_exist(key: str) -> None:
    engine = Engine(str(shipped.DEMO_LIBRARY), UNSET[key])
    assert key in flat(tomllib.loads(engine.settings_toml))


def test_service() -> None:
    with pytest.raises(EgpError, match="unknown field") as refused:
        Server('library = "a"\nnonsense = 1')
    _, _, known = str(refused.value).partition("expected one of")
    table = documented("Service")
    assert list(table) == re.findall(r"`(\w+)`", known)
    source = (ROOT / "rust/service/src/config.rs").read_text(encoding="utf-8")
    functions = dict(re.findall(r"fn default_(\w+)\(\) -> \w+ \{\s+([^\n]+)\n\}", source))
    stated = {key: str(value) for key, value in table.items() if value is not None}
    assert stated.pop("log_json") == "False"  # serde's default
    assert {key.removesuffix("_ms"): value for key, value in stated.items()} == {
        key: value.removesuffix(".to_owned()").strip('"') for key, value in functions.items()
    }


def test_client() -> None:
    source = (ROOT / "python/egp_service/control/client.py").read_text(encoding="utf-8")
    (connect,) = (
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef) and node.name == "connect"
    )
    arguments = zip(connect.args.kwonlyargs, connect.args.kw_defaults, strict=True)
    defaults = {a.arg: ast.literal_eval(default) for a, default in arguments if default is not None}
    # Another section describes the gate's settings, and zenoh's own documentation those of zenoh.
    del defaults["gate"], defaults["zenoh_config"]
    assert documented("Client") == defaults


def commands(settings: Mapping[str, float]) -> list[tuple[float, float]]:
    """Commands of a gate to plans at the limits, and of its tail and its stop."""
    gate = Gate(0.02, dict(settings))
    given = []
    for tick in range(160):
        if tick < 100:
            sign = -1.0 if tick % 50 < 25 else 1.0
            gate.accept(tick, [(2e4 * sign, 0.6 * sign)] * 128)
        # Fast, slow, and with the wheels turned to the left, near their limit.
        v_x, delta = (4.0, 0.905) if 25 <= tick < 50 else (30.0 - 29.0 * (tick % 2), 0.0)
        given.append(gate.command(tick, v_x, delta).u)
    return given


def test_gate() -> None:
    table = documented("Gate")
    with pytest.raises(EgpError, match="known: ") as refused:
        Gate(0.02, {"nonsense": 1.0})
    assert list(table) == re.findall(r"\w+", str(refused.value).partition("known: ")[2])
    np.testing.assert_allclose(commands(table), commands({}), rtol=1e-12)


@pytest.mark.parametrize("key", documented("Gate"))
def test_the_comparison_of_gates_sees_every_setting(key: str) -> None:
    table = documented("Gate")
    changed = table[key] - 1 if key == "max_tail_ticks" else 0.99 * table[key]
    assert not np.allclose(commands({key: changed}), commands({}), rtol=1e-9, atol=0.0)


def members(kind: type, prefix: str = "") -> dict[str, Any]:
    """List the fields of a dataclass by dotted name, with their defaults."""
    found: dict[str, Any] = {}
    hints = get_type_hints(kind)
    for field in fields(kind):
        own = next((a for a in get_args(hints[field.name]) if is_dataclass(a)), hints[field.name])
        if is_dataclass(own):
            found |= members(own, f"{prefix}{field.name}.")  # type: ignore[arg-type]
        else:
            found[prefix + field.name] = None if field.default is MISSING else field.default
    return found


def test_scenarios() -> None:
    assert documented("Scenarios") == members(Scenario)


def test_speed_limits() -> None:
    parameters = itertools.islice(inspect.signature(SpeedProfile).parameters.values(), 1, None)
    assert documented("Speed limits") == {p.name: p.default for p in parameters}
