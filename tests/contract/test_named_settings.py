"""Errors of settings and libraries in Python name what was given, not the text made from it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from egp_service import Controller, EgpError, InvalidArgumentError, Library, Plant, shipped
from egp_service.cli import app
from egp_service.simulation.scenario import parse_scenario, told_zones
from egp_service.simulation.scenario_checks import ScenarioError

GATE = Plant().parameters.gate_limits()
SCENARIO = """
name = "mine"
[track]
kind = "circle"
[[zones]]
start = 0.0
friction = 0.8
"""


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (
            {"cost": {"laterl": 3}},
            "settings.cost.laterl: unknown; known: `longitudinal`, ",
        ),
        ({"coost": {"lateral": 3}}, "settings.coost: unknown; known: `horizon`"),
        ({"cost.lateral": 3}, "'cost.lateral'; nest it, as in {'cost': {'lateral': 3}}"),
        ({"weights": {"prior": {"kind": "l3"}}}, "settings.weights.prior.kind: unknown variant"),
        ({"weights": {"prior": {"alpha": 1.0}}}, "settings.weights.prior: missing field `kind`"),
        ({"horizon": 2.5}, "settings.horizon: invalid type"),
    ],
)
def test_a_setting_of_a_mapping_is_named(settings: dict[str, Any], told: str) -> None:
    with pytest.raises(InvalidArgumentError, match=re.escape(told)) as caught:
        Controller(shipped.DEMO_LIBRARY, settings, gate=GATE)
    assert "TOML" not in str(caught.value)


def test_a_setting_of_a_mapping_outside_its_range_is_named() -> None:
    with pytest.raises(EgpError, match=r"setting `cost\.lateral` must be"):
        Controller(shipped.DEMO_LIBRARY, {"cost": {"lateral": -1.0}}, gate=GATE)


def test_a_text_of_settings_is_shown_where_it_is_wrong() -> None:
    with pytest.raises(EgpError, match=r"^settings cannot be used: TOML parse error at line 2"):
        Controller(shipped.DEMO_LIBRARY, "[cost]\nlaterl = 3.0", gate=GATE)


def test_a_library_in_place_of_its_path_is_named() -> None:
    library: Any = Library.load(shipped.DEMO_LIBRARY)
    with pytest.raises(InvalidArgumentError, match=r"expected the path of a library.*Library$"):
        Controller(library, gate=GATE)


@pytest.mark.parametrize(
    ("control", "told"),
    [
        ("[control.cost]\nlaterl = 3", "mine.toml: control.cost.laterl: unknown; known:"),
        ('[control]\n"cost.lateral" = 3', "mine.toml: control: unknown name 'cost.lateral'; nest"),
        ("[control.cost]\nlateral = -1", "mine.toml: setting `cost.lateral` must be"),
    ],
)
def test_a_setting_of_a_scenario_is_named_with_the_file(control: str, told: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(told)):
        parse_scenario(SCENARIO + control, Path(), "mine.toml")


@pytest.mark.parametrize(
    ("stated", "reason"),
    [
        ("risk = 0.0001", "risk has no effect while speed.knows is 'zones'"),
        ("preview = false", "preview has no effect while speed.knows is 'zones'"),
        ('knows = "here"\nrisk = 0.1', "risk has no effect while speed.knows is 'here'"),
        ('knows = "nothing"\nfriction = 0.3\nrisk = 0.1', "while speed.friction is 0.3"),
    ],
)
def test_a_risk_without_effect_is_an_error(stated: str, reason: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(reason)):
        parse_scenario(f"{SCENARIO}[speed]\n{stated}", Path(), "mine.toml")


def test_what_has_no_effect_is_not_kept_in_a_scenario_that_is_told_the_zones() -> None:
    text = f'{SCENARIO}[speed]\nknows = "nothing"\nrisk = 0.1\npreview = false\n'
    told = told_zones(parse_scenario(text, Path(), "mine.toml"))
    assert parse_scenario(told.toml(), Path(), "mine.toml") == told


@pytest.mark.parametrize("where", [["--in-process"], []])
def test_a_library_that_is_not_there_is_named_alone(tmp_path: Path, where: list[str]) -> None:
    command = ["drive", "--library", str(tmp_path / "nope"), "-o", str(tmp_path), *where]
    error = CliRunner().invoke(app, command).exception
    assert isinstance(error, EgpError)
    assert str(error).startswith(f"cannot read the library {tmp_path / 'nope'}: ")
