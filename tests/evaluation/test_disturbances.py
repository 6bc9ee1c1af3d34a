"""The experiment of disturbances: libraries of its own, and differences paired by seed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service._core import Library, write_library_subset
from egp_service.cli import app
from egp_service.evaluation import disturbances
from egp_service.evaluation.batch import finish
from egp_service.evaluation.campaign import Campaign, Outcome
from egp_service.evaluation.claims import check
from egp_service.evaluation.contenders import ENSEMBLE
from egp_service.evaluation.disturbances import (
    DISTURBED,
    ELSEWHERE,
    FITTED,
    GENTLE,
    NAME,
    WITH_RESIDUAL,
    compare,
    rows,
)
from egp_service.evaluation.experiment import CUSTOM_TRACK
from egp_service.evaluation.experiments import with_members
from egp_service.evaluation.library import make_disturbed
from egp_service.shipped import DEMO_LIBRARY, DISTURBANCE_RECIPE, EVALUATION_LIBRARY
from egp_service.training.recipe import Displays
from outcome_example import OUTCOME

if TYPE_CHECKING:
    from pathlib import Path

FIRST, *OTHERS = DISTURBED
# Sizes of the recipe that are cut for this test.
CUT = {
    "runs = 4": "runs = 1",
    "samples = 200": "samples = 60",
    "episodes = 20": "episodes = 4",
    "max_points = 250": "max_points = 40",
    "steady = 200": "steady = 60",
    "rounds = 1": "rounds = 0",
}


def test_members_are_trained_with_the_disturbance_and_drive_with_it(tmp_path: Path) -> None:
    trials = [
        replace(trial, scenario=replace(trial.scenario, laps=0.1))
        for trial in disturbances.experiment().trials([0])
        if trial.condition == FIRST
    ]
    assert [t.contender.name for t in trials] == [
        *(name + where for where in ("", ELSEWHERE) for name in (ENSEMBLE, FITTED)),
        ENSEMBLE + ELSEWHERE + WITH_RESIDUAL,
    ]
    assert all(t.scenario.disturbances == DISTURBED[FIRST] for t in trials)
    assert trials[0].scenario.track == CUSTOM_TRACK
    campaign = Campaign(tmp_path, EVALUATION_LIBRARY)
    with pytest.raises(EgpError, match="egp evaluate --full -e disturbances trains it"):
        campaign.runs(trials, lambda _: None)
    recipe = tmp_path / "recipe.toml"
    text = DISTURBANCE_RECIPE.read_text(encoding="utf-8")
    for old, new in CUT.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    recipe.write_text(text, encoding="utf-8")
    path = campaign.disturbed_library(FIRST)
    make_disturbed(path, DISTURBED[FIRST], Displays(), recipe=recipe, jobs=1)
    own = Library.load(path).members
    assert [member.friction for member in own] == [0.5, 1.1]
    batch = campaign.runs(trials, lambda _: None)
    finish([batch], 1)
    assert all(outcome.completed for outcome in batch.results())
    # Each contender has the library of its own vehicle, with or without Gaussian processes.
    members = [Library.load(trial.scenario.library).members for trial in batch.parts.values()]
    assert [found[0].n_points for found in members] == [40, 0, 400, 0, 400]
    assert [found[0].dataset == own[0].dataset for found in members] == [
        True,
        True,
        False,
        False,
        False,
    ]
    # The residual changes the drive.
    errors = {outcome.contender: outcome.lateral_rms for outcome in batch.results()}
    assert errors[ENSEMBLE + ELSEWHERE + WITH_RESIDUAL] != errors[ENSEMBLE + ELSEWHERE]
    # The same library serves the conditions with less grip.
    gentle = replace(trials[0], condition=FIRST + GENTLE)
    (of_gentle,) = campaign.runs([gentle], lambda _: None).parts.values()
    assert of_gentle.scenario.library == next(iter(batch.parts.values())).scenario.library
    # Another library of the disturbance is another trial.
    first = list(batch.parts)
    other = Campaign(tmp_path / "other", EVALUATION_LIBRARY)
    other.disturbed_library(FIRST).parent.mkdir()
    other.disturbed_library(FIRST).write_bytes(DEMO_LIBRARY.read_bytes())
    second = list(other.runs(trials, lambda _: None).parts)
    assert [a == b for a, b in zip(first, second, strict=True)] == [False, False, True, True, True]


def test_processes_of_the_undisturbed_vehicle_do_not_mislead_one_whose_brakes_pull(
    tmp_path: Path,
) -> None:
    condition = "brakes pull left by 50 %"
    trials = [
        trial
        for trial in disturbances.experiment().trials([0])
        if (trial.condition, trial.contender.name) == (condition, ENSEMBLE + ELSEWHERE)
    ]
    batch = Campaign(tmp_path, EVALUATION_LIBRARY).runs(trials, lambda _: None)
    finish([batch], 1)
    (driven,) = batch.results()
    assert driven.completed
    # Measured: 0.02 m. With the slopes of the processes in place of the vehicles' 0.08 m.
    assert driven.lateral_rms < 0.04


def test_a_library_of_a_disturbance_that_is_trained_again_is_used(tmp_path: Path) -> None:
    trial = next(t for t in disturbances.experiment().trials([0]) if t.condition == FIRST)
    campaign = Campaign(tmp_path, EVALUATION_LIBRARY)
    path = campaign.disturbed_library(FIRST)
    path.parent.mkdir()
    for members in ([0, 1], [2, 3]):
        write_library_subset(EVALUATION_LIBRARY, path, members)
        (own,) = campaign.runs([trial], lambda _: None).parts.values()
        used = [member.dataset for member in Library.load(own.scenario.library).members]
        assert used == [member.dataset for member in Library.load(path).members]


def test_libraries_of_disturbances_need_no_members_of_the_evaluation() -> None:
    experiment = disturbances.experiment()
    own = replace(experiment, contenders=experiment.contenders[:2])
    assert with_members(DEMO_LIBRARY, [own]) == [own]
    with pytest.raises(EgpError, match="2 members, these experiments need 4"):
        with_members(DEMO_LIBRARY, [experiment])


def outcome(condition: str, contender: str, seed: int, rms: float) -> Outcome:
    return replace(
        OUTCOME,
        experiment=NAME,
        condition=condition,
        contender=contender,
        seed=seed,
        lateral_rms=rms,
    )


def runs(condition: str, contender: str, gain: float) -> list[Outcome]:
    """Errors that differ more between seeds than between contenders."""
    return [outcome(condition, contender, s, 0.01 + 0.01 * s + gain) for s in range(20)]


def test_differences_are_paired_by_seed() -> None:
    found = runs(FIRST, ENSEMBLE, 0.0) + runs(FIRST, FITTED, 0.0005)
    (comparison,) = compare(found, ENSEMBLE, FITTED)
    assert comparison.closer
    assert comparison.gain.value == pytest.approx(0.0005)
    assert comparison.gain.low == pytest.approx(0.0005)
    # An incomplete run is no pair, and costs the comparison.
    lost = [replace(found[0], completed=False, lateral_rms=0.0), *found[1:]]
    (comparison,) = compare(lost, ENSEMBLE, FITTED)
    assert comparison.completed == (19, 20)
    assert comparison.gain.value == pytest.approx(0.0005)
    assert not comparison.closer
    assert compare(found, FITTED, ENSEMBLE)[0].gain.value == pytest.approx(-0.0005)
    assert compare(found, ENSEMBLE, FITTED, GENTLE) == []
    assert rows(found) == [(FIRST, "+0.50 (+0.50 to +0.50)", "-", "-")]
    found += runs(FIRST, ENSEMBLE + ELSEWHERE, 0.002)
    gains = (FIRST, "+0.50 (+0.50 to +0.50)", "+2.00 (+2.00 to +2.00)")
    assert rows(found) == [(*gains, "-")]
    # The residual takes a part of what the undisturbed members lack.
    found += runs(FIRST, ENSEMBLE + ELSEWHERE + WITH_RESIDUAL, 0.0012)
    assert rows(found) == [(*gains, "+0.80 (+0.80 to +0.80)")]
    # One pair has no interval, and decides nothing.
    one = [o for o in found if o.seed == 0]
    assert rows(one) == [(FIRST, "+0.50", "+2.00", "+0.80")]
    assert not compare(one, ENSEMBLE, FITTED)[0].closer
    # Where one of the two completes no run, there is no pair.
    none = [replace(o, completed=False) if o.contender == FITTED else o for o in found]
    ((_, text, *_),) = rows(none)
    assert text == "no seed that both completed, completed 20 and 0 of 20"


def test_an_evaluation_of_nothing_is_an_error(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    result = CliRunner().invoke(app, ["evaluate", "-e", "disturbances", "-o", str(folder)])
    assert isinstance(result.exception, EgpError)
    assert "add --full" in str(result.exception)
    assert not folder.exists()


def test_the_claim_needs_half_of_the_disturbances() -> None:
    def claim(gains: list[float]) -> bool | None:
        found = []
        for condition, gain in zip(DISTURBED, gains, strict=True):
            found += runs(condition, ENSEMBLE, 0.0) + runs(condition, FITTED, gain)
        (only,) = check(found, [])
        return only.holds

    assert claim([0.001, 0.001, 0.001, 0.0, 0.0, -0.001])
    assert not claim([0.001, 0.001, 0.0, 0.0, 0.0, 0.0])
