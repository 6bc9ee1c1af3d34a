"""Scenario files: the built-in ones can be driven, and errors name the field at fault."""

from __future__ import annotations

import inspect
import re
import tomllib
from dataclasses import fields
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from egp_service import EgpError, VehicleParameters
from egp_service._core import Plant
from egp_service.cli.settings_file import read_settings
from egp_service.control.toml_text import dumps
from egp_service.simulation.configuration import ConfigurationError
from egp_service.simulation.course import (
    TRACKS,
    build_path,
    build_profile,
    narrow_place,
    tight_place,
)
from egp_service.simulation.scenario import (
    Disturbances,
    Scenario,
    built_in_names,
    gate_settings,
    load_scenario,
    parse_scenario,
)
from egp_service.simulation.scenario_checks import ScenarioError

DOCUMENT = Path(__file__).parents[2] / "docs/settings.md"
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
        (("friction = 0.8", 'friction = "wet"'), r"zones\[0\]: friction must be a number"),
        (("friction = 0.8", "friction = 0.8\nright = 0"), r"zones\[0\].right must be positive"),
        (("[track]", "[speed]\ngrip = 85\n[track]"), "mine.toml: speed.grip .* at most 1, got 85"),
        (
            ("friction = 0.8", "friction = 0.8\n[[zones]]\nstart = 30.0\nfriction = 0.5"),
            r"mine.toml: zones\[1\].start must be below 1, .*, got 30.0; .* zones_in_metres = true",
        ),
        (("[track]", "[speed]\ngirp = 0.9\n[track]"), "speed: unknown field 'girp'"),
        (
            ("[track]", '[speed]\nknows = "all"\n[track]'),
            "one of zones, here, weights, nothing, got 'all'",
        ),
        (("[track]", "[speed]\nrisk = 1.0\n[track]"), "speed.risk must be between 0 and 1"),
        (
            ("[track]", '[speed]\nknows = "here"\nfriction = 0.0\n[track]'),
            "speed.friction must be positive",
        ),
        (("[track]", "[speed]\nfriction = 0.3\n[track]"), "speed.friction has no effect while"),
        (("[track]", "laps = true\n[track]"), "laps must be a number, got True"),
        (("[track]", "vehicle = -1\n[track]"), "vehicle is -1: expected a number of CommonRoad"),
        (("friction = 0.8", ""), r"zones\[0\]: expected `friction` or `surface`, got neither"),
        (("friction = 0.8", 'friction = 0.8\nsurface = "ice"'), r"zones\[0\]: .*got both"),
        (("friction = 0.8", 'surface = "mud"'), r"zones\[0\]: no surface .*dry, wet, snow, ice"),
        (("friction = 0.8", "surface = 0.8"), r"zones\[0\]: surface must be a text or a table"),
        (("friction = 0.8", "surface = {stiffness = 0.5}"), r"zones\[0\]: .* needs its `peak`"),
        (("friction = 0.8", "surface = {peak = 0.5, grip = 1}"), "unknown field `grip`"),
        (("friction = 0.8", "surface = {peak = 0}"), "coefficient > 0 and at most 3, got 0"),
        (("friction = 0.8", "friction = 8.0"), r"mine.toml: zones\[0\]: .*at most 3, got 8"),
        (("friction = 0.8", "surface = {peak = 1, shape = 2}"), "0.75 to 1.218 on the shape"),
        (
            ("friction = 0.8", 'friction = 0.8\nright = 0.5\nsurface_right = "ice"'),
            "`right` or `surface_right`, got both",
        ),
        (("[track]", "[disturbances]\nlaod = 9\n[track]"), "disturbances: unknown field 'laod'"),
        (("[track]", "[disturbances]\nload = -9\n[track]"), "disturbance load from 0 to 1000 kg"),
        (("[track]", "[disturbances]\nbrake_bias = 1\n[track]"), "disturbance brake_bias from"),
        (("[[zones]]", "[[zones"), "not TOML"),
        (("mine", "../../mine"), "name must be 1 to 50 letters, .* got '../../mine'"),
        (("mine", ".."), "name must be"),
        (('"mine"', r'"a\u0000b"'), "name must not contain the character NUL"),
        (
            ("[track]", 'library = "a\\u0000b"\n[track]'),
            "library must not contain the character NUL",
        ),
        (("[track]", "seed = -1\n[track]"), "seed must be a whole number from 0"),
        (("[track]", "laps = inf\n[track]"), "laps must be a finite number, got inf"),
        (
            ('[track]\nkind = "rounded-rectangle"', 'laps = 3\n[track]\nkind = "lane-change"'),
            "mine.toml: laps is 3, which has no effect on a track that is not closed",
        ),
        (("[track]", "[measurement]\nposition = nan\n[track]"), "position must be a finite number"),
        (("[track]", "[measurement]\npsi = -1.0\n[track]"), "measurement.psi must be at least 0"),
        (("[[zones]]", 'file = "a.csv"\n[[zones]]'), "track.file is for track kind 'csv', got"),
        (("[track]", f"laps = {'9' * 400}\n[track]"), "laps must be a number below .* 400 digits"),
        (("[track]", f"laps = {'9' * 5000}\n[track]"), "not TOML: Exceeds the limit"),
        (("[[zones]]", "parameters = {radius = nan}\n[[zones]]"), "radius must be a finite number"),
        (
            ("[track]", "[speed]\nv_max = 120\nconstant = true\n[track]"),
            "mine.toml: speed.v_max must be 0.001 to 100 m/s, got 120",
        ),
        (("[track]", "[speed]\nv_max = 1e-200\n[track]"), "speed.v_max must be 0.001 to 100 m"),
        (
            ("[track]", "[speed]\nv_start = -8\n[track]"),
            "speed.v_start must be 0 to 100 m/s, got -8",
        ),
        (("[track]", "[speed]\nv_start = 101\n[track]"), "speed.v_start must be 0 to 100 m/s"),
        *(
            (
                ("[track]", f"[speed]\nconstant = true\n{name} = {value}\n[track]"),
                f"mine.toml: speed.{name} has no effect while speed.constant is True; .*`{name}`",
            )
            for name, value in (
                ("knows", "'nothing'"),
                ("friction", "0.3"),
                ("grip", "0.2"),
                ("tyres", "true"),
                ("risk", "0.2"),
            )
        ),
        (
            ('"rounded-rectangle"', '"oval"'),
            "mine.toml: track.kind: no track 'oval'; known: circle",
        ),
        (('"rounded-rectangle"', '"csv"'), "mine.toml: track.file is missing, .*kind 'csv' needs"),
        (
            ('"rounded-rectangle"', '"csv"\nfile = "nope.csv"'),
            "mine.toml: track.file: nope.csv: No such file or directory",
        ),
        (
            ("[[zones]]", "parameters = {length = 1}\n[[zones]]"),
            "mine.toml: track.parameters: a side of 1 m is too short",
        ),
        (
            ("[[zones]]", "parameters = {track_width = -4}\n[[zones]]"),
            r"mine.toml: track.parameters: expected a length .* for track_width, got -4",
        ),
        *(
            (
                ('"rounded-rectangle"', f'"circle"\nparameters = {{radius = {radius}}}'),
                f"mine.toml: track.parameters: expected a radius above 0 m, got {radius}",
            )
            for radius in (-50, 0)
        ),
        (
            ('"rounded-rectangle"', '"circle"\nparameters = {radius = 0.1}'),
            "mine.toml: track.parameters: the path is 0.628.* m long: expected 1 to 1e.06 m",
        ),
        (
            ("[track]", 'vehicle_file = "nope.toml"\n[track]'),
            "mine.toml: vehicle_file: nope.toml: No such file or directory$",
        ),
    ],
)
def test_what_is_wrong_is_named(change: tuple[str, str], complaint: str) -> None:
    with pytest.raises(ConfigurationError, match=complaint):
        parse(MINIMAL.replace(*change, 1))


def test_a_scenario_by_a_relative_path_can_be_read_again_from_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = MINIMAL.replace("[track]", 'library = "own.safetensors"\n[track]', 1)
    Path("own.toml").write_text(text)
    scenario = load_scenario("own.toml")
    assert scenario.library == str(tmp_path / "own.safetensors")
    assert parse_scenario(scenario.toml(), tmp_path / "runs", "again") == scenario


def test_a_split_road_has_its_own_friction_on_the_right() -> None:
    scenario = parse(MINIMAL.replace("friction = 0.8", "friction = 0.8\nright = 0.4"))
    assert scenario.zones[0].right == 0.4
    assert parse(scenario.toml()) == scenario
    assert build_path(scenario).sample(np.zeros(1))[6] == pytest.approx(0.6)


def test_a_zone_has_a_surface_in_place_of_a_friction() -> None:
    factors = "stiffness = 0.2, shape = 1.05, lateral_curvature = 1.03, shift = 0.3"
    table = f"surface = {{peak = 0.3, {factors}}}"
    scenario = parse(MINIMAL.replace("friction = 0.8", f'{table}\nsurface_right = "ice"'))
    assert parse(scenario.toml()) == scenario
    (zone,) = scenario.zones
    assert zone.sides() == (zone.surface, "ice")
    # The speed profile sees the peaks, 0.3 and 0.1.
    assert build_path(scenario).sample(np.zeros(1))[6] == pytest.approx(0.2)
    mixed = parse(MINIMAL.replace("friction = 0.8", 'surface = "snow"\nright = 0.5'))
    assert mixed.zones[0].sides() == ("snow", 0.5)
    assert mixed.zones[0].friction is None


def test_disturbances_of_a_scenario_are_those_of_the_plant() -> None:
    text = MINIMAL.replace("[track]", "[disturbances]\ngrade = 0.1\nload = 100\n[track]")
    scenario = parse(text)
    assert parse(scenario.toml()) == scenario
    assert (scenario.disturbances.grade, scenario.disturbances.load) == (0.1, 100.0)
    # The plant knows each field by the same name.
    for field in fields(Disturbances):
        Plant(1, {field.name: 0.0})
    with pytest.raises(EgpError, match="unknown field"):
        Plant(1, {"mood": 0.0})


@pytest.mark.parametrize("text", ["\u00fc \U0001f697", "a\x7fb", 'a "\\" \t\n\x01'])
def test_toml_text_reads_back(text: str) -> None:
    assert tomllib.loads(dumps({"value": text, text: [text]})) == {"value": text, text: [text]}


@pytest.mark.parametrize(
    ("value", "complaint"),
    [(date(1979, 5, 27), "got the date 1979-05-27"), ("\udcff", "expected text in UTF-8")],
)
def test_what_configurations_do_not_have_is_an_error(value: object, complaint: str) -> None:
    with pytest.raises(EgpError, match=complaint):
        dumps({"value": value})


def test_a_scenario_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.symlink_to("/proc/self/mem")  # a regular file, of which a read at its start fails
    with pytest.raises(ScenarioError, match=r"own\.toml: Input/output error"):
        load_scenario(str(file))


def test_a_scenario_that_is_no_text_is_named(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    file.write_bytes(b"\x89MCAP")
    with pytest.raises(ScenarioError, match=r"run\.mcap: expected the TOML file of a scenario"):
        load_scenario(str(file))


def test_files_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    scenario, settings = tmp_path / "scenario.toml", tmp_path / "settings.toml"
    scenario.write_text(MINIMAL, encoding="utf-8-sig")
    assert load_scenario(str(scenario)) == parse(MINIMAL)
    settings.write_text("[cost]\nlateral = 20.0\n", encoding="utf-8-sig")
    assert read_settings(settings) == {"cost": {"lateral": 20.0}}


def test_an_unknown_scenario_names_the_known_ones() -> None:
    with pytest.raises(ScenarioError, match="rounded-rectangle"):
        load_scenario("figure-of-nine")


@pytest.mark.parametrize(
    ("kind", "known"),
    [
        ("circle", "radius, track_width"),
        ("circuit", "length, min_radius, track_width"),
        ("rounded-rectangle", "length, width, radius, transition, track_width"),
        ("csv", "scale"),
    ],
)
def test_an_unknown_measure_of_a_track_is_refused(kind: str, known: str) -> None:
    text = MINIMAL.replace("[[zones]]", "[track.parameters]\nradus = 3.0\n[[zones]]")
    text = text.replace("rounded-rectangle", kind)
    told = f"mine.toml: track.parameters.radus: unknown for kind '{kind}'; known: {known}"
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, Path(), "mine.toml")
    assert str(caught.value) == told


@pytest.mark.parametrize("kind", TRACKS)
def test_the_measures_of_a_track_are_documented(kind: str) -> None:
    (line,) = re.findall(rf"(?m)^- `{kind}`: (.+)$", DOCUMENT.read_text(encoding="utf-8"))
    known = inspect.signature(TRACKS[kind]).parameters.values()
    stated = dict(re.findall(r"`(\w+)`(?: \(([^\s)]+))?", line))
    assert stated.keys() == {each.name for each in known} - {"file", "closed"}
    for each in known:
        if each.name in stated and each.default is not each.empty:
            assert float(stated[each.name]) == each.default


def test_a_road_that_is_narrower_than_the_car_is_told() -> None:
    text = MINIMAL.replace("[[zones]]", "parameters = {track_width = 1.5}\n[[zones]]")
    told = narrow_place(parse(text))
    assert told is not None
    assert told.startswith("The road is 1.50 m wide at 0 m of the path, less than the")
    assert narrow_place(parse(MINIMAL)) is None


def test_a_path_that_turns_tighter_than_the_car_is_told(tmp_path: Path) -> None:
    text = MINIMAL.replace("rounded-rectangle", "circle")
    told = tight_place(parse(text.replace("[[zones]]", "parameters = {radius = 1.5}\n[[zones]]")))
    assert told is not None
    # The wheelbase of 2.4 m over the tangent of 0.91 rad.
    assert re.match(r"The path turns with a radius of 1\.50 m at s = .* is 1\.87 m: make", told)
    # A square with sharp corners, in a file, which begins 1 m behind one.
    side = np.arange(1.0, 20.0, 2.0)
    x = np.concatenate([side, 0.0 * side + 20.0, 20.0 - side, 0.0 * side])
    rows = "".join(f"{a},{b},4,4\n" for a, b in zip(x, np.roll(x, len(side)), strict=True))
    (tmp_path / "square.csv").write_text(f"x_m,y_m,w_tr_right_m,w_tr_left_m\n{rows}")
    text = MINIMAL.replace('"rounded-rectangle"', '"csv"\nfile = "square.csv"')
    told = tight_place(parse_scenario(text, tmp_path, "mine.toml"))
    assert told is not None
    assert re.search(r"at s = \d+\.\d m, .*: smooth the points of its file", told)
    for name in built_in_names():
        assert tight_place(load_scenario(name)) is None


@pytest.mark.parametrize("seed", ["-3.0", "0.5", "1e300"])
def test_the_seed_of_a_track_is_a_whole_number(seed: str) -> None:
    text = MINIMAL.replace("rounded-rectangle", "random")
    text = text.replace("[[zones]]", f"parameters = {{seed = {seed}}}\n[[zones]]")
    with pytest.raises(ScenarioError, match=r"track.parameters.seed must be a whole number"):
        build_path(parse(text))


def test_zones_in_metres_and_from_a_file_are_those_in_fractions(tmp_path: Path) -> None:
    path = build_path(parse(MINIMAL))
    head = MINIMAL.partition("[[zones]]")[0]
    fractions = parse(MINIMAL + "[[zones]]\nstart = 0.25\nfriction = 0.5\nright = 0.3\n")
    (tmp_path / "zones.csv").write_text(
        f"\ufeff# made by hand\nstart;friction;right\n0;0,8;\n{0.25 * path.length};0,5;0,3\n",
        encoding="utf-8",
    )
    text = 'zones_in_metres = true\nzones_file = "zones.csv"\n' + head
    metres = parse_scenario(text, tmp_path, "mine.toml")
    s = np.linspace(0.0, path.length, 500)
    np.testing.assert_array_equal(
        build_path(metres).sample(s)[-1], build_path(fractions).sample(s)[-1]
    )
    with pytest.raises(
        ScenarioError, match=r"mine.toml: zones\[1\].start is 9000 m, but the path is .* m long"
    ):
        parse(f"zones_in_metres = true\n{MINIMAL}[[zones]]\nstart = 9000\nfriction = 0.5\n")
    # The file is no longer needed by the resolved scenario.
    assert parse(metres.toml()) == metres
    (tmp_path / "zones.csv").write_text("start,friction\n0.0,0.8\n10.0,slippery\n")
    with pytest.raises(ConfigurationError, match=r"zones.csv: line 3: friction .* 'slippery'"):
        parse_scenario(text, tmp_path, "mine.toml")


@pytest.mark.parametrize(
    ("rows", "complaint"),
    [
        ('start,friction\n0.0,"0.8\n0.5,0.5\n', "line 2: .* is a quotation mark missing"),
        ('start,"friction\n0.0,0.8\n', "line 1: .* is a quotation mark missing"),
        ('# c\nstart,surface\n\n0.0,"dry"t\n', "line 4: .* is a quotation mark missing"),
    ],
)
def test_a_line_of_zones_with_half_a_quotation_is_named(
    tmp_path: Path, rows: str, complaint: str
) -> None:
    (tmp_path / "zones.csv").write_text(rows)
    text = 'zones_file = "zones.csv"\n' + MINIMAL.partition("[[zones]]")[0]
    with pytest.raises(ConfigurationError, match=rf"zones\.csv: {complaint}"):
        parse_scenario(text, tmp_path, "mine.toml")
    (tmp_path / "zones.csv").write_text('start,surface\n0.0,"dry"\n')
    assert parse_scenario(text, tmp_path, "mine.toml").zones[0].surface == "dry"
    with pytest.raises(ScenarioError, match="zones_file must not contain the character NUL"):
        parse_scenario(text.replace("zones.csv", "z\\u0000s"), tmp_path, "mine.toml")


def test_the_file_of_a_vehicle_gives_gate_and_speeds(tmp_path: Path) -> None:
    car = VehicleParameters.commonroad(1).fields() | {"a_max": 2.0, "lateral_grip": 0.44}
    (tmp_path / "car.toml").write_text("".join(f"{key} = {car[key]}\n" for key in car))
    millimetres = "".join(f"{key} = {car[key] * (1e3 if key == 'l_f' else 1)}\n" for key in car)
    (tmp_path / "millimetres.toml").write_text(millimetres)
    with pytest.raises(ScenarioError, match=r"vehicle_file: .*`l_f` is 900.*check its unit"):
        parse_scenario('vehicle_file = "millimetres.toml"\n' + MINIMAL, tmp_path, "mine.toml")
    plain = parse(MINIMAL)
    own = parse_scenario('vehicle_file = "car.toml"\n' + MINIMAL, tmp_path, "mine.toml")
    assert gate_settings(own)["force_max"] == pytest.approx(2.0 * car["mass"])
    times = [build_profile(each, build_path(each)).lap_time for each in (plain, own)]
    assert times[1] > 1.2 * times[0]
