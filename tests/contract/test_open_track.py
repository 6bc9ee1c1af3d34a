"""Open tracks from CSV files."""

from __future__ import annotations

import re
from pathlib import Path as FilePath

import numpy as np
import pytest

from egp_service import EgpError, Path
from egp_service.simulation.course import build_path, road_name
from egp_service.simulation.scenario import Scenario, parse_scenario
from egp_service.simulation.scenario_checks import ScenarioError

S = np.arange(0.0, 200.0, 5.0)
# A slow bend to the left, whose ends are far apart.
X, Y = 150.0 * np.sin(S / 150.0), 150.0 * (1.0 - np.cos(S / 150.0))
CENTRE_LINE = ["x_m", "y_m", "w_tr_right_m", "w_tr_left_m"]
RACELINE = ["s_m", "x_m", "y_m", "psi_rad", "kappa_radpm", "vx_mps", "ax_mps2"]
COLUMNS = {
    "s_m": S,
    "x_m": X,
    "y_m": Y,
    "w_tr_right_m": 0.0 * S + 3.0,
    "w_tr_left_m": 0.0 * S + 4.0,
    "psi_rad": S / 150.0,
    "kappa_radpm": 0.0 * S + 1.0 / 150.0,
    "vx_mps": 0.0 * S + 10.0,
    "ax_mps2": 0.0 * S,
}
OWN = """
name = "own"
zones = [{start = 0.0, friction = 0.8}]
[track]
kind = "csv"
file = "lane.csv"
closed = false
"""


def table(names: list[str], separator: str = ",", header: str = "# ") -> str:
    rows = np.column_stack([COLUMNS[name] for name in names])
    lines = [separator.join(f"{value:.6f}" for value in row) for row in rows]
    return "\n".join([header + separator.join(names), *lines, ""])


def own(folder: FilePath, text: str = OWN) -> Scenario:
    return parse_scenario(text, folder, "own.toml")


@pytest.mark.parametrize(
    "text",
    [
        table(CENTRE_LINE),
        table(CENTRE_LINE, header=""),
        table(CENTRE_LINE[::-1], ";"),
        "\ufeff# of a lane\n\n" + table(CENTRE_LINE),
        table(RACELINE, ";"),
        table(RACELINE[::-1], "; ", header=""),
    ],
)
def test_an_open_track_ends_where_its_file_ends(tmp_path: FilePath, text: str) -> None:
    (tmp_path / "lane.csv").write_text(text, encoding="utf-8")
    path = build_path(own(tmp_path))
    assert not path.closed
    assert path.length == pytest.approx(S[-1], abs=0.01)
    x, y, _, curvature, left, right, _ = path.sample(S)
    np.testing.assert_allclose([x, y], [X, Y], atol=1e-3)
    np.testing.assert_allclose(curvature[4:-4], 1.0 / 150.0, rtol=1e-3)
    wide = (4.0, 3.0) if "w_tr" in text else (np.inf, np.inf)
    assert (left[0], right[0]) == pytest.approx(wide)


def test_the_scale_is_that_of_a_closed_track(tmp_path: FilePath) -> None:
    (tmp_path / "lane.csv").write_text(table(CENTRE_LINE))
    path = build_path(own(tmp_path, OWN + "parameters = {scale = 0.1}\n"))
    assert path.length == pytest.approx(0.1 * S[-1], abs=1e-3)
    with pytest.raises(ScenarioError, match=r"track.file: .*for scale, got -1"):
        own(tmp_path, OWN + "parameters = {scale = -1}\n")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x\n", "line 1: expected 4 columns x_m, y_m, w_tr_right_m, w_tr_left_m, got 1"),
        ("0,0,1,1\n1,0,oops,1\n", r"line 2: expected a finite number for w_tr_right_m, got .oops."),
        ("# x_m,y_m\n0,0,1,1\n", "line 1: expected a header with the columns .* got x_m, y_m"),
        ("0,0,1,1\n", "expected at least 4 distinct points, got 1"),
        ("", "expected at least 4 distinct points, got 0"),
        ("\xff", "expected a text in UTF-8, got other bytes"),
    ],
)
def test_what_a_closed_track_does_not_accept_an_open_one_does_not_either(
    tmp_path: FilePath, text: str, told: str
) -> None:
    file = tmp_path / "lane.csv"
    file.write_text(text, encoding="latin-1")
    for closed in (True, False):
        with pytest.raises(EgpError, match=rf"lane\.csv: {told}"):
            Path.from_csv(file, closed=closed)


def test_headings_that_are_none_are_an_error(tmp_path: FilePath) -> None:
    file = tmp_path / "lane.csv"
    swapped = [*RACELINE[:3], "kappa_radpm", "psi_rad", *RACELINE[5:]]
    text = table(swapped, ";").splitlines()[1:]
    file.write_text("\n".join(text))
    with pytest.raises(EgpError, match=r"lane\.csv: psi_rad agrees .* from \+x .mean error 0"):
        Path.from_csv(file, closed=False)


def test_a_file_that_is_not_closed_says_how_to_state_it(tmp_path: FilePath) -> None:
    (tmp_path / "lane.csv").write_text(table(CENTRE_LINE))
    for text in (OWN.replace("closed = false\n", ""), OWN.replace("false", "true")):
        with pytest.raises(ScenarioError, match=r"if this track is open, state closed = false"):
            own(tmp_path, text)


@pytest.mark.parametrize("closed", ["true", "false"])
@pytest.mark.parametrize("kind", ["lane-change", "rounded-rectangle"])
def test_only_a_track_from_a_file_is_closed_or_not(kind: str, closed: str) -> None:
    text = OWN.replace('"csv"\nfile = "lane.csv"', f'"{kind}"').replace("false", closed)
    told = f"own.toml: track.closed is for track kind 'csv', got kind '{kind}': .* leave out `clos"
    with pytest.raises(ScenarioError, match=told):
        own(FilePath(), text)


def test_laps_of_an_open_track_are_an_error(tmp_path: FilePath) -> None:
    (tmp_path / "lane.csv").write_text(table(CENTRE_LINE))
    with pytest.raises(ScenarioError, match=re.escape("laps is 2, which has no effect on a track")):
        own(tmp_path, "laps = 2\n" + OWN)


def test_an_open_track_is_another_road_than_a_closed_one(tmp_path: FilePath) -> None:
    angle = 2.0 * np.pi * np.arange(40) / 40
    rows = np.column_stack([30 * np.cos(angle), 30 * np.sin(angle), np.full((40, 2), 3.0)])
    np.savetxt(tmp_path / "lane.csv", rows, delimiter=",")
    ends = ("", "closed = true\n", "closed = false\n")
    scenarios = [own(tmp_path, OWN.replace("closed = false\n", text)) for text in ends]
    unstated, closed, opened = map(road_name, scenarios)
    assert unstated == closed != opened
    assert parse_scenario(scenarios[2].toml(), FilePath("/"), "again") == scenarios[2]
