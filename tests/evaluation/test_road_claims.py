"""Claims about unknown roads count what they are about."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from egp_service.evaluation.claims import check
from egp_service.evaluation.contenders import ORACLE
from egp_service.evaluation.fleet_roads import ALONE, FLEET, OUTVOTED
from egp_service.evaluation.statistics import grouped
from egp_service.evaluation.unknown_roads import ASSUMED, BELIEF, FIRST, LATER, lap_rows
from outcome_example import OUTCOME

if TYPE_CHECKING:
    from egp_service.evaluation.campaign import Outcome


def test_the_second_lap_is_claimed_for_runs_that_all_complete_it() -> None:
    told = [
        replace(OUTCOME, experiment=LATER, contender=ORACLE, seed=seed, lap_times=(30.0,) * 5)
        for seed in range(3)
    ]

    def claimed(*laps: tuple[float, ...]) -> tuple[bool | None, str]:
        own = [
            replace(
                OUTCOME,
                experiment=LATER,
                contender=f"{BELIEF}5%",
                seed=seed,
                completed=len(times) == 5,
                lap_times=times,
            )
            for seed, times in enumerate(laps)
        ]
        (claim,) = (claim for claim in check([*told, *own], []) if "second lap" in claim.text)
        return claim.holds, claim.evidence

    whole, slow, left = (33.0, 31.0, 30.0, 30.0, 30.0), (33.0, 32.0), (33.0, 30.0, 30.0)
    assert claimed(whole, whole, left) == (True, f"{BELIEF}5%: 3 of 3 second laps of 3 runs, 1.033")
    assert claimed(whole, slow, slow) == (False, f"{BELIEF}5%: 3 of 3 second laps of 3 runs, 1.067")
    assert claimed(left, left, (33.0,)) == (
        False,
        f"{BELIEF}5%: 2 of 3 second laps of 3 runs, 1.000",
    )
    assert claimed(left, left, ()) == (False, f"{BELIEF}5%: 2 of 2 second laps of 3 runs, 1.000")
    # The claim does not disappear where nobody completes the lap.
    assert claimed((33.0,), (), ()) == (False, f"{BELIEF}5%: 0 of 1 second laps of 3 runs")


def test_a_risk_that_completes_no_first_lap_is_compared_with_the_best_assumption() -> None:
    def runs(contender: str, time: float, completed: int) -> list[Outcome]:
        return [
            replace(
                OUTCOME,
                experiment=FIRST,
                contender=contender,
                seed=seed,
                completed=seed < completed,
                time=time,
            )
            for seed in range(4)
        ]

    def claimed(completed: int) -> tuple[bool | None, str]:
        others = [*runs(ORACLE, 20.0, 4), *runs(f"{ASSUMED}0.3", 30.0, 3)]
        own = [*runs(f"{BELIEF}3%", 30.0, 4), *runs(f"{BELIEF}20%", 30.0, completed)]
        (claim,) = (claim for claim in check([*others, *own], []) if "equal time" in claim.text)
        return claim.holds, claim.evidence

    assert claimed(4) == (True, f"at worst +1.0 of 4 ({BELIEF}20%)")
    assert claimed(2) == (False, f"at worst -1.0 of 4 ({BELIEF}20%)")
    assert claimed(0) == (False, f"at worst -3.0 of 4 ({BELIEF}20%)")


def test_a_risk_gains_nothing_from_losing_slow_roads() -> None:
    def run(contender: str, seed: int, completed: bool) -> Outcome:  # noqa: FBT001
        slow = 30.0 if seed < 5 else 20.0
        return replace(
            OUTCOME,
            experiment=FIRST,
            contender=contender,
            seed=seed,
            completed=completed,
            time=20.0 if contender == ORACLE else slow,
        )

    found = [
        run(contender, seed, contender != f"{BELIEF}5%" or seed > 3)
        for contender in (ORACLE, f"{ASSUMED}0.4", f"{BELIEF}5%")
        for seed in range(10)
    ]
    (claim,) = (claim for claim in check(found, []) if "equal time" in claim.text)
    # On each road both take the same time, but the belief loses four of the slow ones.
    assert (claim.holds, claim.evidence) == (False, f"at worst -4.0 of 10 ({BELIEF}5%)")


def test_a_wrong_map_costs_the_laps_that_are_completed_without_it() -> None:
    def claimed(outvoted: list[bool], alone: list[bool]) -> tuple[bool | None, str]:
        found = [
            replace(OUTCOME, experiment=FLEET, contender=name, seed=seed, completed=completed)
            for name, runs in ((OUTVOTED, outvoted), (ALONE, alone))
            for seed, completed in enumerate(runs)
        ]
        (claim,) = (claim for claim in check(found, []) if "wrong map" in claim.text)
        return claim.holds, claim.evidence

    assert claimed([True, True, False], [True, False, False]) == (
        True,
        "2 of 3, without a map 1",
    )
    # As many are completed, but not the same.
    assert claimed([True, False, False], [False, True, False]) == (
        False,
        "1 of 3, without a map 1; completed only without a map: seed 1",
    )


def test_all_laps_of_a_row_are_of_the_same_runs() -> None:
    told = [
        replace(
            OUTCOME, experiment=LATER, contender=ORACLE, seed=s, time=50.0, lap_times=(10.0,) * 5
        )
        for s in range(3)
    ]
    laps = ((12.0, 11.0, 10.0, 10.0, 10.0), (30.0,), (30.0, 20.0))

    def run(name: str, seed: int, times: tuple[float, ...]) -> Outcome:
        return replace(
            OUTCOME,
            experiment=LATER,
            contender=name,
            seed=seed,
            completed=len(times) == 5,
            time=sum(times),
            lap_times=times,
        )

    careful, risky = f"{BELIEF}3%", f"{BELIEF}10%"
    own = [run(careful, seed, times) for seed, times in enumerate(laps)]
    own += [run(risky, seed, (9.0,)) for seed in range(3)]
    found = [*told, *own]
    assert lap_rows(grouped(found), found) == [
        (careful, "1/3", "1.060", "1.200", "1.100", "1.000", "1.000", "1.000"),
        (risky, "0/3", *["-"] * 6),
    ]
    (claim,) = (claim for claim in check(found, []) if "Five laps" in claim.text)
    assert claim.evidence == "1 of 3, 1.060; laps 1.200, 1.100, 1.000, 1.000, 1.000"
