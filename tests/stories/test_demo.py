"""The laps of `egp demo`, the first command of README, each a small part of a lap."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from typer.testing import CliRunner

from egp_service import simulation
from egp_service.cli import app
from egp_service.cli.demo import LAPS, SCENARIO, TOLD, drive_laps

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
