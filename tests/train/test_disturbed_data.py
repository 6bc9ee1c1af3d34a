"""Data of a vehicle with a disturbance: every way of collecting has it, and names it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service.cli import app
from egp_service.data.dataset import Dataset
from egp_service.data.experiment import Experiment
from egp_service.data.exploration import ExplorationSettings, explore
from egp_service.data.exploration_track import ExplorationTrack
from egp_service.data.sampling import sample
from egp_service.shipped import DEMO_LIBRARY, DISTURBANCE_RECIPE
from egp_service.training.on_policy import OnPolicySettings, drive_laps
from egp_service.training.recipe import Recipe

if TYPE_CHECKING:
    from pathlib import Path

PLAIN = Experiment(friction=1.1, label="dry", seed=3)
# The road falls to the right, so that the vehicle is drawn there.
BANKED = replace(PLAIN, disturbances={"bank": 0.1})
STIFFNESS = 20.9  # lateral force over load and slip angle, 1/rad, of the simulated tyres
DOWNHILL = 9.81 * np.sin(0.1)  # m/s²


def test_random_states_are_driven_with_the_disturbance() -> None:
    plain, banked = sample(PLAIN, 100), sample(BANKED, 100)
    # The vehicle moves sideways by gravity less the tyres' reaction; v_y is positive to the left.
    drawn = float(np.median(banked.y[:, 1]) - np.median(plain.y[:, 1])) / PLAIN.dt
    assert -DOWNHILL < drawn < -0.1 * DOWNHILL
    assert plain.provenance.method == "random sampling"
    assert banked.provenance.method == "random sampling with bank 0.1"


def test_runs_and_laps_are_driven_with_the_disturbance() -> None:
    settings = ExplorationSettings(episodes=2)
    track = ExplorationTrack("rounded-rectangle", PLAIN.parameters)
    plain, banked = (explore(e, track, settings) for e in (PLAIN, BANKED))
    assert plain.digest() != banked.digest()
    one = OnPolicySettings(rounds=1, laps=1, grip=(0.6, 0.6))
    (plain,), (banked,) = (
        drive_laps(DEMO_LIBRARY, [surface], one, jobs=1) for surface in (PLAIN, BANKED)
    )
    # Against gravity the tyres need this slip angle, by which the vehicle points uphill.
    angle = np.tan(0.1) / STIFFNESS
    sideslip = [float(np.mean(laps.z[:, 1] / laps.z[:, 0])) for laps in (plain, banked)]
    assert sideslip[1] - sideslip[0] == pytest.approx(-angle, rel=0.3)
    assert banked.provenance.method == "closed loop with bank 0.1"


def test_a_recipe_states_disturbances() -> None:
    recipe = Recipe.read(DISTURBANCE_RECIPE)
    assert [e.disturbances for e in recipe.experiments] == [{"load": 300.0, "load_y": 0.6}] * 2


def test_a_recipe_with_an_unknown_disturbance_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "recipe.toml"
    text = DISTURBANCE_RECIPE.read_text(encoding="utf-8")
    path.write_text(text.replace("load_y", "lode_y"), encoding="utf-8")
    with pytest.raises(EgpError, match="lode_y"):
        Recipe.read(path)


def test_the_command_takes_disturbances(tmp_path: Path) -> None:
    def collect(*options: str) -> str:
        output = tmp_path / "data.parquet"
        arguments = ["collect", "-o", str(output), "--friction", "0.8", "--runs", "0"]
        result = CliRunner().invoke(app, [*arguments, "--samples", "20", "--steady", "0", *options])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code == 0, result.output
        return Dataset.read(output).provenance.method

    assert collect() == "random sampling"
    loaded = collect("--disturbance", "load=300", "--disturbance", "load_y=0.6")
    assert loaded == "random sampling with load 300, load_y 0.6"
    with pytest.raises(EgpError, match="expected NAME=VALUE"):
        collect("--disturbance", "load")
    with pytest.raises(EgpError, match="load"):
        collect("--disturbance", "load=5000")
