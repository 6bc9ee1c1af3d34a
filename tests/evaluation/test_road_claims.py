"""Claims about unknown roads count what they are about."""

from __future__ import annotations

from dataclasses import replace

from egp_service.evaluation.claims import check
from egp_service.evaluation.contenders import ORACLE
from egp_service.evaluation.unknown_roads import BELIEF, LATER
from outcome_example import OUTCOME


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
