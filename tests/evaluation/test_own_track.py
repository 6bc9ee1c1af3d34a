"""A circuit from the user's file takes the place of the generated one, by one command."""

from __future__ import annotations

import csv
import re
from typing import TYPE_CHECKING
from unittest.mock import Mock

import numpy as np
import pytest
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service.cli import app
from egp_service.evaluation import experiments, summary_report
from egp_service.evaluation.campaign import SHOWN_CONTENDERS, fingerprint
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE
from egp_service.evaluation.experiments import EXPERIMENTS, on_track
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.scenario import load_scenario
from egp_service.simulation.scenario_checks import ScenarioError
from fewer_contenders import with_contenders

if TYPE_CHECKING:
    from pathlib import Path

UNSEEN = next(experiment for experiment in EXPERIMENTS if experiment.name == "unseen-track")
# Those whose drives are compared in a picture, and the oracle.
CONTENDERS = (*SHOWN_CONTENDERS, ORACLE)


def write_centre_line(file: Path, radius: float) -> None:
    """Write a bent oval, as the track database of TUM has them, for 1:10 cars."""
    angle = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    r = radius * (1.0 + 0.1 * np.cos(3.0 * angle))
    rows = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full((60, 2), 0.4)])
    np.savetxt(file, rows, fmt="%.6f", delimiter=",", header="x_m,y_m,w_tr_right_m,w_tr_left_m")


def test_edges_that_are_too_far_name_file_and_scale(tmp_path: Path) -> None:
    write_centre_line(tmp_path / "oval.csv", 0.05)
    scenario = tmp_path / "own.toml"
    scenario.write_text(
        'name = "own"\nzones = [{start = 0.0, friction = 1.0}]\n'
        '[track]\nkind = "csv"\nfile = "oval.csv"\nparameters = {scale = 4000}\n'
    )
    told = r"own.toml: track.file: an edge of \S*oval.csv is 1600 m from .* track.parameters.scale$"
    with pytest.raises(ScenarioError, match=told):
        load_scenario(str(scenario))


def test_one_command_drives_a_circuit_of_ones_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiments, "EXPERIMENTS", (with_contenders(UNSEEN, *CONTENDERS),))
    file = tmp_path / "oval.csv"
    write_centre_line(file, 3.2)
    arguments = ["evaluate", "-e", "unseen-track", "--track", str(file), "--scale", "10"]
    arguments += ["-o", str(tmp_path / "out")]
    with monkeypatch.context() as patch:
        patch.setattr(summary_report, "write_report", Mock(side_effect=KeyboardInterrupt))
        interrupted = CliRunner().invoke(app, arguments)
    assert interrupted.exit_code != 0
    told = "Interrupted. The same command goes on with the report of the finished runs."
    assert told in " ".join(interrupted.output.split())
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    text = (tmp_path / "out" / "runs.csv").read_text(encoding="utf-8")
    runs = list(csv.DictReader(text.splitlines()))
    assert {row["condition"] for row in runs} == {"14 m/s on oval"}
    assert len(runs) == len(CONTENDERS)
    (own,) = (row for row in runs if row["contender"] == ENSEMBLE)
    assert own["completed"] == "True"
    assert 190.0 < float(own["distance"]) < 230.0
    # The report opens with contents, tables and pictures.
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    sections = re.findall(r'<a href="#(section-\d+)">', report)
    assert len(sections) > 2
    assert all(f'id="{section}"' in report for section in sections)
    # The terminal has the table of the best controllers, too.
    head, body = report.partition("Best controllers</h2>")[::2]
    assert "<h2" in head
    assert re.search(r"<td>unseen-track</td><td>14 m/s on oval</td><td>1/1, 0\.\d+ m</td>", body)
    assert "unseen-track" in result.output
    sources = re.findall(r'<img [^>]*src="([^"]{0,22})', report)
    assert len(sources) > 1
    assert set(sources) == {"data:image/png;base64,"}


def test_runs_belong_to_what_the_file_says(tmp_path: Path) -> None:
    file = tmp_path / "oval.csv"
    prints = []
    for radius in (3.0, 3.2):
        write_centre_line(file, radius)
        trial = next(on_track(UNSEEN, file, 10.0).trials([0]))
        prints.append(fingerprint(trial, "any"))
    assert prints[0] != prints[1]


def test_what_cannot_be_driven_is_refused_first(tmp_path: Path) -> None:
    file = tmp_path / "notes.csv"
    file.write_text("not,a,track\n", encoding="utf-8")
    with pytest.raises(EgpError, match=r"notes\.csv: line 1: expected 4 columns"):
        on_track(UNSEEN, file, 1.0)
    write_centre_line(file, 3.0)
    with pytest.raises(EgpError, match="scale"):
        on_track(UNSEEN, file, 0.0)
    with pytest.raises(EgpError, match=r"scale 0.001: .*notes\.csv: expected at least 0.1 m"):
        on_track(UNSEEN, file, 1e-3)
    result = CliRunner().invoke(app, ["evaluate", "-e", "lane-change", "--track", str(file)])
    assert isinstance(result.exception, EgpError)
    for option, *value in (["--scale", "10"], ["--open"]):
        result = CliRunner().invoke(app, ["evaluate", "-e", "unseen-track", option, *value])
        assert str(result.exception) == f"{option} requires --track: give both"


def test_a_track_that_is_not_closed_is_driven_to_its_end(tmp_path: Path) -> None:
    file = tmp_path / "lane.csv"
    s = np.arange(0.0, 60.0, 5.0)
    np.savetxt(file, np.column_stack([s, 0.0 * s, np.full((len(s), 2), 3.0)]), delimiter=",")
    with pytest.raises(EgpError, match="if this track is open, state closed = false, or --open"):
        on_track(UNSEEN, file, 1.0)
    own = on_track(UNSEEN, file, 1.0, closed=False)
    scenario = next(own.trials([0])).scenario
    with in_process_controller(scenario) as controller:
        run = drive(scenario, controller, lambda _: None)
    assert run.summary.ending.completed
    assert run.trace.distance[-1] == pytest.approx(s[-1], abs=0.5)
