"""Scenario files: the built-in ones can be driven, and errors name the field at fault."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from egp_service.simulation.configuration import ConfigurationError
from egp_service.simulation.course import build_path, build_profile
from egp_service.simulation.scenario import (
    Scenario,
    ScenarioError,
    built_in_names,
    load_scenario,
    parse_scenario,
)

MINIMAL = """
name = "mine"
[track]
kind = "rounded-rectangle"
[[zones]]
start = 0.0
friction = 0.8
"""


def parse(text: str) -> Scenario:
    return parse_scenario(text, Path(), "mine.toml")


@pytest.mark.parametrize("name", built_in_names())
def test_built_in_scenarios_have_a_course(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    path = build_path(scenario)
    profile = build_profile(scenario, path)
    assert path.length > 50.0
    assert 0.0 < profile.lap_time < 600.0


@pytest.mark.parametrize("name", built_in_names())
def test_the_resolved_text_is_the_same_scenario(name: str) -> None:
    scenario = load_scenario(name)
    assert parse_scenario(scenario.toml(), Path("/"), name) == scenario


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (("name", "nmae"), "unknown field 'nmae'"),
        (('name = "mine"', ""), "'name' is missing"),
        (("start = 0.0", "start = 0.1"), "begin with one at start = 0.0"),
        (("friction = 0.8", "friction = -1.0"), r"zones\[0\].friction must be positive"),
        (("friction = 0.8", 'friction = "wet"'), r"zones\[0\]: friction must be float"),
        (("friction = 0.8", "friction = 0.8\nright = 0"), r"zones\[0\].right must be positive"),
        (("[track]", "[speed]\ngirp = 0.9\n[track]"), "speed: unknown field 'girp'"),
        (("[track]", "laps = true\n[track]"), "laps must be float"),
        (("[[zones]]", "[[zones"), "not TOML"),
    ],
)
def test_what_is_wrong_is_named(change: tuple[str, str], complaint: str) -> None:
    with pytest.raises(ConfigurationError, match=complaint):
        parse(MINIMAL.replace(*change, 1))


def test_a_split_road_has_its_own_friction_on_the_right() -> None:
    scenario = parse(MINIMAL.replace("friction = 0.8", "friction = 0.8\nright = 0.4"))
    assert scenario.zones[0].right == 0.4
    assert parse(scenario.toml()) == scenario
    assert build_path(scenario).sample(np.zeros(1))[6] == pytest.approx(0.6)


def test_an_unknown_scenario_names_the_known_ones() -> None:
    with pytest.raises(ScenarioError, match="rounded-rectangle"):
        load_scenario("figure-of-nine")


def test_an_unknown_measure_of_a_track_is_refused() -> None:
    text = MINIMAL.replace("[[zones]]", "[track.parameters]\nradus = 3.0\n[[zones]]")
    with pytest.raises(ScenarioError, match="radus"):
        build_path(parse_scenario(text, Path(), "mine.toml"))
