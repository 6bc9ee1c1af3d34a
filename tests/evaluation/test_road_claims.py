"""Claims about unknown roads count what they are about."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from egp_service.evaluation.claims import check
from egp_service.evaluation.contenders import ORACLE
from egp_service.evaluation.unknown_roads import ASSUMED, BELIEF, FIRST, LATER
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
