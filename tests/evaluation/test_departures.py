"""Departures are replayed in the same states, and are avoidable or not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from egp_service._core import write_library_subset
from egp_service.evaluation import departures, figures
from egp_service.evaluation.campaign import Outcome, run_trial
from egp_service.evaluation.claims import check
from egp_service.evaluation.contenders import ORACLE, Contender, make
from egp_service.evaluation.departures import avoidable, departed, last_border, replay
from egp_service.evaluation.experiment import CUSTOM_TRACK, NOISE, Trial
from egp_service.evaluation.statistics import grouped
from egp_service.evaluation.unknown_roads import ASSUMED, BELIEF, FIRST, WEIGHTED, departure_rows
from egp_service.shipped import EVALUATION_LIBRARY
from egp_service.simulation.closed_loop import TOO_LONG, Run, drive
from egp_service.simulation.scenario import Scenario, Speed, Zone
from outcome_example import OUTCOME

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

# From a border on a straight there is time to brake before the bend; in the bend there is none.
EARLY, LATE = 0.40, 0.64
SLIPPERY = 0.3
DRIVER = Contender("assumed", "ensemble", (0, 3))


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("departures") / "two.safetensors"
    write_library_subset(EVALUATION_LIBRARY, path, [0, 3])
    return path


def scenario(library: Path, border: float, assumed: float = 0.9) -> Scenario:
    """Drive at the speed of an assumed friction onto a slippery surface."""
    return Scenario(
        name="slippery from here",
        track=CUSTOM_TRACK,
        zones=(Zone(0.0, 1.1), Zone(border, SLIPPERY)),
        speed=Speed(grip=0.9, v_max=16.0, knows="nothing", friction=assumed),
        measurement=NOISE,
        library=str(library),
    )


def driven(library: Path, border: float, assumed: float = 0.9) -> Run:
    road = scenario(library, border, assumed)
    return drive(road, make(DRIVER, road), lambda _: None)


@pytest.fixture(scope="module")
def early(library: Path) -> Run:
    return driven(library, EARLY)


@pytest.fixture(scope="module")
def late(library: Path) -> Run:
    return driven(library, LATE)


@pytest.fixture(scope="module")
def careful(library: Path) -> Run:
    return driven(library, LATE, SLIPPERY)


def test_a_replay_has_the_same_states_up_to_the_border_and_other_ones_after_it(early: Run) -> None:
    run = early
    assert departed(run)
    border = last_border(run)
    assert run.trace.friction[border] == 1.1
    assert run.trace.friction[border + 1] == SLIPPERY
    again = replay(DRIVER, run)
    told = slice(border + 1)
    assert np.array_equal(again.trace.x[told], run.trace.x[told])
    assert np.array_equal(again.trace.u[:border], run.trace.u[:border])
    assert not np.array_equal(again.trace.u[told], run.trace.u[told])
    # The reference speed is that of all zones, and the weights those of the nearest member.
    assert again.trace.friction_planned[border + 2] == SLIPPERY
    assert again.trace.weights[border + 5] == pytest.approx([1.0, 0.0])


def test_a_departure_is_avoidable_unless_the_vehicle_came_too_fast(
    early: Run, late: Run, careful: Run
) -> None:
    assert avoidable(DRIVER, early) is True
    assert avoidable(DRIVER, late) is False
    assert avoidable(DRIVER, careful) is None


def test_a_border_that_is_crossed_beside_the_path_is_not_the_last_one(late: Run) -> None:
    run = late
    slid = int(np.argmax(np.abs(run.trace.lateral_error) > 1.0))
    friction = run.trace.friction.copy()
    friction[slid:] = 0.2  # as if another surface began where the vehicle is already lost
    later = replace(run, trace=replace(run.trace, friction=friction))
    assert last_border(later) == last_border(run) < slid
    # Without any border the run is replayed from its start.
    same = replace(run, trace=replace(run.trace, friction=np.full_like(friction, 0.3)))
    assert last_border(same) == 0


def ended(run: Run, reason: str) -> Run:
    ending = replace(run.summary.ending, completed=False, reason=reason)
    return replace(run, summary=replace(run.summary, ending=ending))


@pytest.mark.parametrize("reason", [TOO_LONG, "stopped by the gate: invalid_state: v_x"])
def test_a_run_that_ended_on_the_road_is_no_departure(
    early: Run, careful: Run, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not departed(ended(careful, reason))
    assert departed(ended(careful, "lost control: spin"))
    # Such a replay does not say that the vehicle came too fast.
    monkeypatch.setattr(departures, "replay", lambda *_: ended(careful, reason))
    assert avoidable(DRIVER, early) is None


def test_departures_of_unknown_roads_are_counted_and_break_the_claim(library: Path) -> None:
    def outcome(name: str, border: float, assumed: float = 0.9) -> Outcome:
        road = scenario(library, border, assumed)
        return run_trial(Trial(FIRST, "", Contender(name, "ensemble", (0, 3)), road))

    def claims(outcomes: list[Outcome]) -> list[tuple[bool | None, str]]:
        return [
            (claim.holds, claim.evidence)
            for claim in check(outcomes, [])
            if "told everything" in claim.text
        ]

    careful, risky = f"{BELIEF}3%", f"{BELIEF}20%"
    outcomes = [outcome(careful, LATE, SLIPPERY), outcome(risky, LATE)]
    assert claims(outcomes) == [(True, "0 of 1 departures in 2 runs")]
    outcomes.append(replace(outcome(risky, EARLY), seed=7))
    assert [o.avoidable for o in outcomes] == [None, False, True]
    assert departure_rows(grouped(outcomes), FIRST) == [
        (careful, "0 of 1", "0", "0"),
        (risky, "2 of 2", "1", "1"),
    ]
    assert claims(outcomes) == [(False, f"1 of 2 departures in 3 runs: {risky}, seed 7")]


def test_the_picture_of_risks_shows_departures_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def runs(name: str, avoidable: list[bool | None]) -> list[Outcome]:
        """Give four runs, of which the last ones are not completed."""
        return [
            replace(
                OUTCOME,
                experiment=FIRST,
                contender=name,
                seed=seed,
                completed=seed < 4 - len(avoidable),
                avoidable=avoidable[seed - 4] if seed >= 4 - len(avoidable) else None,
            )
            for seed in range(4)
        ]

    slow, lost, risky = f"{ASSUMED}0.3", f"{WEIGHTED}100% of it", f"{BELIEF}20%"
    outcomes = [
        *runs(ORACLE, []),
        *runs(slow, [None, None]),  # which took too long
        *runs(risky, [True, False]),
        *runs(lost, [False] * 4),
    ]
    drawn: list[Figure] = []
    monkeypatch.setattr(figures, "save", lambda figure, _: drawn.append(figure))
    figures.draw_risk(grouped(outcomes), tmp_path / "risk.png")
    (ax,) = drawn[0].axes
    shown = {str(line.get_label()): np.asarray(line.get_ydata()).tolist() for line in ax.lines}
    assert shown == {
        "told all zones": [0.0],
        "one friction assumed everywhere": [0.0],
        "found by the control steps": [50.0],
        "friction of the weights, no interval\n(no time: 100% of it)": [],
    }
