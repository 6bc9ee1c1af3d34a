"""Vehicles that are too fast for a bend on a road of unknown friction neither skid nor spin."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from egp_service._core import write_library_subset
from egp_service.evaluation.contenders import make
from egp_service.evaluation.experiment import TWO
from egp_service.evaluation.unknown_roads import BELIEF, first_lap
from egp_service.shipped import EVALUATION_LIBRARY
from egp_service.simulation.closed_loop import drive

if TYPE_CHECKING:
    from pathlib import Path

    from egp_service.simulation.summary import Summary


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("too-fast") / "two.safetensors"
    write_library_subset(EVALUATION_LIBRARY, path, list(TWO))
    return path


def driven(
    library: Path, seed: int, risk: float, control: dict[str, object] | None = None
) -> Summary:
    """Drive a first lap of *unknown-roads*, with other settings of the control step if stated."""
    name = f"{BELIEF}20%"
    (trial,) = (trial for trial in first_lap().trials([seed]) if trial.contender.name == name)
    road = trial.scenario
    scenario = replace(
        road,
        library=str(library),
        control=road.control if control is None else control,
        speed=replace(road.speed, **{**(trial.contender.speed or {}), "risk": risk}),
    )
    return drive(scenario, make(trial.contender, scenario), lambda _: None).summary


def test_on_less_friction_than_all_members_a_vehicle_that_is_too_fast_still_turns(
    library: Path,
) -> None:
    # The road has a friction of 0.27 to 0.47; the members have 0.5 and 1.1.
    kept = driven(library, 32, 0.15, control={})
    assert kept.ending.completed
    assert 0.5 < kept.lateral_error.max < 2.0  # measured 1.06 m


def test_a_vehicle_that_is_too_fast_does_not_spin(library: Path) -> None:
    # With the slopes of the processes in place of the vehicles' it spun here.
    kept = driven(library, 39, 0.2, control={})
    assert kept.ending.completed
    assert kept.lateral_error.max < 2.5  # measured 1.7 m


def test_an_envelope_of_the_lateral_speed_keeps_a_vehicle_in_control(library: Path) -> None:
    lost = driven(library, 39, 0.3, control={})
    assert "lost control" in lost.ending.reason
    kept = driven(library, 39, 0.3)
    assert kept.ending.completed
    assert kept.lateral_error.max < 2.5  # measured 1.9 m
