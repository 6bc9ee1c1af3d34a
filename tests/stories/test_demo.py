"""The laps of `egp demo`, the first command of README, each a small part of a lap."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer.testing import CliRunner

from egp_service import simulation
from egp_service.cli import app
from egp_service.cli.demo import LAPS, SCENARIO, TOLD, Lap, drive_laps

if TYPE_CHECKING:
    import pytest


def test_the_demo_drives_every_lap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = Path(simulation.__file__).parent / f"scenarios/{SCENARIO}.toml"
    short = re.sub(r"(?m)^laps = .*$", "", scenario.read_text(encoding="utf-8"))
    (tmp_path / "short.toml").write_text(f"laps = 0.03\n{short}", encoding="utf-8")
    # The package has a function of the same name, the command.
    module = sys.modules["egp_service.cli.demo"]
    monkeypatch.setattr(module, "SCENARIO", str(tmp_path / "short.toml"))
    observed = set[str]()
    laps = drive_laps(None, tmp_path / "demo", lambda label, _: observed.add(label))
    labels = [lap.label for lap in laps]
    assert labels == [*LAPS, TOLD, "told, μ 0.5", "told, μ 1.1"]
    assert observed == set(labels)
    assert len({lap.folder for lap in laps}) == len(laps)
    for lap in laps:
        assert lap.run.summary.ending.completed, lap.label
        summary = json.loads((lap.folder / "summary.json").read_text(encoding="utf-8"))
        assert summary["ending"]["completed"], lap.label
        assert (lap.folder / "run.mcap").exists(), lap.label


def test_a_member_alone_may_lose_its_lap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = Path(simulation.__file__).parent / f"scenarios/{SCENARIO}.toml"
    (tmp_path / "short.toml").write_text(f"laps = 0.03\n{scenario.read_text(encoding='utf-8')}")
    module = sys.modules["egp_service.cli.demo"]
    monkeypatch.setattr(module, "SCENARIO", str(tmp_path / "short.toml"))

    def lost_with(lap: Lap) -> Lap:
        ending = replace(lap.run.summary.ending, completed=False, reason="slid off the road")
        summary = replace(lap.run.summary, ending=ending)
        return replace(lap, run=replace(lap.run, summary=summary))

    def drive(*arguments: Any) -> list[Lap]:  # noqa: ANN401 - those of the function
        return [lost_with(lap) if lap.alone else lap for lap in drive_laps(*arguments)]

    monkeypatch.setattr(module, "drive_laps", drive)
    result = CliRunner().invoke(app, ["demo", "-o", str(tmp_path / "runs")])
    assert result.exit_code == 0, result.output
    assert "Not completed: told, μ 0.5, told, μ 1.1." in " ".join(result.output.split())
    assert "The first lap, planned for the estimated friction, takes" in result.output


def test_laps_that_were_not_completed_show_in_the_exit_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = 'name = "fast"\nlaps = 0.2\n[track]\nkind = "circle"\n'
    scenario += "[[zones]]\nstart = 0.0\nfriction = 0.8\n[speed]\nconstant = true\nv_max = 30.0\n"
    (tmp_path / "fast.toml").write_text(scenario, encoding="utf-8")
    monkeypatch.setattr(
        sys.modules["egp_service.cli.demo"], "SCENARIO", str(tmp_path / "fast.toml")
    )
    result = CliRunner().invoke(app, ["demo", "-o", str(tmp_path / "runs")])
    assert result.exit_code == 3
    assert "Not completed: first lap, " in result.output
