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

from egp_service import SpeedProfile, VehicleParameters, shipped
from egp_service._core import EgpError, Engine, Server
from egp_service._core.testing import Gate, MapServer
from egp_service.simulation.scenario import Scenario
from library_example import write_example

if TYPE_CHECKING:
    from collections.abc import Mapping

ROOT = Path(__file__).parents[2]
DOCUMENT = (ROOT / "docs/settings.md").read_text(encoding="utf-8")
# Settings that the control step does not write while they are not set, with a use of each.
UNSET = {
    "soft.envelope": "[soft]\nenvelope = [8.0, 2.0]",
    "soft.slip": "[soft]\nslip = 0.12",
    "weights.prior.alpha": '[weights.prior]\nkind = "l1"\nalpha = 1e-5',
}


CAR = VehicleParameters.commonroad(1)
# Another vehicle, of which no two parameters are alike and none is the car's.
OTHER = VehicleParameters(
    **{
        name: (1.0625 + 0.015625 * number) * value
        for number, (name, value) in enumerate(CAR.fields().items())
    }
)


def cells(section: str) -> dict[str, str]:
    """Keys of a section with the text of their column of defaults."""
    (text,) = re.findall(
        rf"^## \d+\. {section}\n(.*?)(?=^## |\Z)", DOCUMENT, re.MULTILINE | re.DOTALL
    )
    found: dict[str, str] = {}
    for key, cell in re.findall(r"^\| `([\w.]+)` \| ([^|]*) \|", text, re.MULTILINE):
        assert key not in found, f"{key} is documented twice"
        found[key] = cell
    return found


def documented(section: str, vehicle: VehicleParameters | None = None) -> dict[str, Any]:
    """Keys of a section with their defaults for a vehicle; a key without a default has `None`."""
    found: dict[str, Any] = {}
    for key, cell in cells(section).items():
        value = re.match(r"`([^`]*)`", cell)
        assert value or cell.startswith("none"), f"{key}: {cell}"
        found[key] = evaluated(value[1], vehicle) if value else None
    return found


def evaluated(text: str, vehicle: VehicleParameters | None) -> Any:  # noqa: ANN401 - any TOML value
    """Give the value that is written as TOML, or as a formula of a vehicle's parameters."""
    if "vehicle." in text:
        return eval(text, {"__builtins__": {}}, {"vehicle": vehicle})  # noqa: S307
    return tomllib.loads(f"value = {text}")["value"]


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
    assert documented("Control step", CAR) == expected | dict.fromkeys(UNSET)


def test_defaults_that_come_from_the_librarys_vehicle(tmp_path: Path) -> None:
    path = tmp_path / "library.safetensors"
    write_example(path, vehicle=OTHER)
    settings = flat(tomllib.loads(Engine(str(path)).settings_toml))
    table = documented("Control step", OTHER)
    changed = {key for key, value in table.items() if value != documented("Control step", CAR)[key]}
    assert changed == {key for key, cell in cells("Control step").items() if "vehicle." in cell}
    assert {key: settings[key] for key in changed} == {key: table[key] for key in changed}
    # The example has another period than the document, but otherwise the same defaults.
    others = settings.keys() - changed - {"horizon", "weights.window"}
    assert {key: settings[key] for key in others} == {key: table[key] for key in others}


@pytest.mark.parametrize("key", UNSET)
def test_settings_that_are_not_set_exist(key: str) -> None:
    engine = Engine(str(shipped.DEMO_LIBRARY), UNSET[key])
    assert key in flat(tomllib.loads(engine.settings_toml))


# Defaults in Rust that are not literals, by the values that the document states.
WRITTEN: dict[str, Any] = {
    "None": None,
    "BTreeMap::new()": None,
    "Settings::default()": None,
    "library.into()": None,
    "Vec::new()": [],
    "false": False,
}


def rust_source(file: str) -> str:
    return (ROOT / "rust" / file).read_text(encoding="utf-8")


def written(file: str) -> dict[str, str]:
    """Give the defaults of a configuration as its source has them."""
    (log,) = re.findall(
        r'const DEFAULT_LOG: &str =\s+("[^"]+");', rust_source("service/src/config.rs")
    )
    _, _, source = rust_source(file).partition("\n        Self {")
    fields, _, _ = source.partition("\n        }")
    found = re.findall(r"^            (\w+): ([^\n]+),$", fields, re.MULTILINE)
    return {key: value.replace("DEFAULT_LOG", log) for key, value in found}


def check_written(table: Mapping[str, Any], rust: Mapping[str, str]) -> None:
    """Check that the document states the defaults of the source."""
    for key, value in table.items():
        text = rust[key].removesuffix(".to_owned()")
        if not text.startswith('"'):
            text = text.replace("_", "")  # Rust's separator of digits
        assert value == (WRITTEN[text] if text in WRITTEN else evaluated(text, None)), key


def test_service() -> None:
    with pytest.raises(EgpError, match="unknown field") as refused:
        Server('library = "a"\nnonsense = 1')
    _, _, known = str(refused.value).partition("expected one of")
    table = documented("Service")
    assert list(table) == re.findall(r"`(\w+)`", known)
    check_written(table, written("service/src/config.rs"))


def test_map_service() -> None:
    with pytest.raises(EgpError, match="unknown field") as refused:
        MapServer("nonsense = 1")
    _, _, known = str(refused.value).partition("expected one of")
    table = documented("Map service")
    assert list(table) == re.findall(r"`(\w+)`", known)
    merging = re.findall(
        r"^            (\w+): ([\d.]+),$", rust_source("map/src/merge.rs"), re.MULTILINE
    )
    check_written(table, written("service/src/map/config.rs") | dict(merging))


def test_client() -> None:
    source = (ROOT / "python/egp_service/control/client.py").read_text(encoding="utf-8")
    (connect,) = (
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef) and node.name == "connect"
    )
    arguments = zip(connect.args.kwonlyargs, connect.args.kw_defaults, strict=True)
    defaults = {a.arg: default and ast.literal_eval(default) for a, default in arguments}
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


def stated_gate(vehicle: VehicleParameters) -> dict[str, float]:
    """Limits of a vehicle's gate by the document's formulas."""
    formulas = {
        key: re.fullmatch(r"none: `([^`]*vehicle\.[^`]*)`", cell)
        for key, cell in cells("Gate").items()
    }
    return {key: evaluated(formula[1], vehicle) for key, formula in formulas.items() if formula}


def test_gate() -> None:
    defaults = {key: value for key, value in documented("Gate").items() if value is not None}
    limits = CAR.gate_limits()
    with pytest.raises(EgpError, match="known: ") as refused:
        Gate(0.02, limits | {"nonsense": 1.0})
    assert list(cells("Gate")) == re.findall(r"\w+", str(refused.value).partition("known: ")[2])
    # What the document gives no default for is required, and the rest is not.
    assert cells("Gate").keys() - defaults.keys() == stated_gate(CAR).keys()
    for key in stated_gate(CAR):
        with pytest.raises(EgpError, match=f"gate limit {key} is missing"):
            Gate(0.02, {name: value for name, value in limits.items() if name != key})
    np.testing.assert_allclose(commands(stated_gate(CAR) | defaults), commands(limits), rtol=1e-12)


@pytest.mark.parametrize("vehicle", [CAR, OTHER], ids=["car", "other"])
def test_the_limits_of_a_vehicles_gate(vehicle: VehicleParameters) -> None:
    assert stated_gate(vehicle) == pytest.approx(vehicle.gate_limits(), rel=1e-12)


@pytest.mark.parametrize("key", cells("Gate"))
def test_the_comparison_of_gates_sees_every_setting(key: str) -> None:
    table = documented("Gate") | stated_gate(CAR)
    changed = table[key] - 1 if key == "max_tail_ticks" else 0.99 * table[key]
    commanded = commands(table | {key: changed})
    assert not np.allclose(commanded, commands(CAR.gate_limits()), rtol=1e-9, atol=0.0)


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
    defaults = {p.name: None if p.default is p.empty else p.default for p in parameters}
    assert documented("Speed limits") == defaults


def test_vehicle() -> None:
    assert documented("Vehicle") == CAR.fields()
    bmw = VehicleParameters.commonroad(2).fields()
    own = {name for name, value in CAR.fields().items() if bmw[name] != value}
    assert own == {"mass", "yaw_inertia", "l_f", "l_r", "width"}  # as the document says
