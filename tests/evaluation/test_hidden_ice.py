"""A patch of ice is hidden at a place of its kind, found on the first lap, and taken carefully."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from egp_service._core import write_library_subset
from egp_service.evaluation.claims import check
from egp_service.evaluation.experiments import HIDDEN_ICE
from egp_service.evaluation.hidden_ice import HEADS, LARGEST_ERROR, IceOutcome, rows, run
from egp_service.evaluation.unknown_roads import BELIEF
from egp_service.shipped import EVALUATION_LIBRARY
from egp_service.simulation.course import build_path

if TYPE_CHECKING:
    from pathlib import Path

    from egp_service.evaluation.experiment import Trial

TRIALS = list(HIDDEN_ICE.trials(range(3)))


def test_patches_have_their_length_and_lie_in_bends_or_on_straights() -> None:
    places = set()
    for trial in TRIALS:
        path = build_path(trial.scenario)
        dry, ice, after = trial.scenario.zones
        assert (dry.friction, ice.friction, after.friction) == (1.1, 0.25, 1.1)
        length, _, kind = trial.condition.split(" ", 2)
        assert (after.start - ice.start) * path.length == pytest.approx(float(length))
        middle = 0.5 * (after.start + ice.start)
        places.add((trial.condition, round(middle, 4)))
        curvature = abs(float(path.sample(np.array([middle * path.length]))[3][0]))
        # The bends have a radius of 20 m.
        assert (curvature > 0.5 / 20.0) == (kind == "in a bend")
    assert len(places) > 2 * len(HIDDEN_ICE.conditions)  # another place for most seeds


def test_only_the_controller_of_the_friction_alone_has_no_limit_by_the_tyres() -> None:
    limited = {
        trial.contender.name: {"tyres": trial.scenario.speed.tyres, **(trial.contender.speed or {})}
        for trial in TRIALS
    }
    assert {name: speed["tyres"] for name, speed in limited.items()} == {
        "oracle": True,
        f"{BELIEF}3%": True,
        f"{BELIEF}5%": True,
        "friction alone, risk 3%": False,
    }


def with_library(trial: Trial, path: Path) -> Trial:
    speed = replace(trial.scenario.speed, **(trial.contender.speed or {}))
    return replace(
        trial, scenario=replace(trial.scenario, library=str(path), laps=2.0, speed=speed)
    )


@pytest.mark.parametrize("risk", ["3%", "5%"])
def test_a_patch_in_a_bend_is_found_on_the_first_lap(tmp_path: Path, risk: str) -> None:
    path = tmp_path / "two.safetensors"
    write_library_subset(EVALUATION_LIBRARY, path, [0, 3])
    trial = next(
        t
        for t in TRIALS
        if t.condition == "20 m in a bend" and t.contender.name == f"{BELIEF}{risk}"
    )
    outcome = run(with_library(trial, path))
    assert outcome.completed, outcome.reason
    assert len(outcome.lap_errors) == 2
    # Nothing is known before the first lap: the median of the prior from 0.1 to 1.3.
    assert outcome.believed[0] == pytest.approx(0.7)
    assert outcome.believed[1] < 0.4
    assert outcome.found[:2] == (False, True)
    assert outcome.errors_after == outcome.lap_errors[1:]
    assert outcome.avoidable is None


def outcome(errors: tuple[float, ...], believed: tuple[float, ...]) -> IceOutcome:
    return IceOutcome(
        experiment=HIDDEN_ICE.name,
        condition="5 m in a bend",
        contender=f"{BELIEF}5%",
        seed=0,
        completed=True,
        reason="completed",
        lap_errors=errors,
        believed=believed,
        avoidable=None,
    )


def test_only_laps_after_the_patch_was_found_count() -> None:
    late = outcome((2.0, 1.0, 0.2), (0.7, 0.9, 0.3, 0.3))
    never = outcome((0.1, 0.9, 0.9), (0.7, 0.9, 0.9, 0.9))
    first = outcome((0.1, 0.2, LARGEST_ERROR + 0.01), (0.7, 0.3, 0.3, 0.3))
    assert late.errors_after == (0.2,)
    assert never.errors_after == ()
    (claim,) = check([], [], [late, never])
    assert claim.holds
    assert claim.evidence.startswith("1 of 1 laps, at worst 0.20 m; found on the first lap in 0")
    (claim,) = check([], [], [late, never, first])
    assert not claim.holds
    assert claim.evidence.startswith("2 of 3 laps, at worst 0.31 m; found on the first lap in 1")
    (claim,) = check([], [], [never])
    assert claim.holds is None
    careful = replace(late, contender=f"{BELIEF}3%")
    assert [claim.holds for claim in check([], [], [first, careful, late])] == [False, True]
    forgotten = outcome((0.1, 0.1, 2.0), (0.7, 0.3, 0.9, 0.3))
    assert forgotten.errors_after == (0.1, 2.0)
    (row,) = rows([late, never, first])
    assert len(row) == len(HEADS)
    assert row[2:] == ("3/3", "0", "0.10", "1", "2 of 3", "0.31")


def test_the_first_lap_of_a_told_vehicle_is_no_later_lap() -> None:
    told = replace(outcome((0.9, 0.1, 0.2), ()), contender="oracle")
    (row,) = rows([told])
    assert row[4:] == ("0.90", "-", "2 of 2", "0.20")
