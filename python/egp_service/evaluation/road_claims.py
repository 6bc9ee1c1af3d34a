"""Claims about roads whose friction the reference speed is not told."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from egp_service.evaluation import fleet_roads, unknown_roads
from egp_service.evaluation.claim import Claim
from egp_service.evaluation.contenders import ORACLE
from egp_service.evaluation.experiments import REPLAYED
from egp_service.evaluation.hidden_ice import LARGEST_ERROR
from egp_service.evaluation.statistics import grouped
from egp_service.evaluation.unknown_roads import ASSUMED, BELIEF, HERE, LATER, RISKS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from egp_service.evaluation.campaign import Outcome
    from egp_service.evaluation.hidden_ice import IceOutcome
    from egp_service.evaluation.statistics import Group

_SECOND_LAP: Final = 1.04
_FIVE_LAPS: Final = 1.12
_SECOND_CAR: Final = 1.06


def check(outcomes: Sequence[Outcome], ice: Sequence[IceOutcome]) -> list[Claim]:
    """Check every claim about unknown roads for which there are outcomes."""
    return [
        *_first_lap(outcomes),
        *_second_lap(outcomes),
        *_five_laps(outcomes),
        *_fleet(outcomes),
        *_departures(outcomes),
        *_ice(ice),
    ]


def _first_lap(outcomes: Sequence[Outcome]) -> list[Claim]:
    """Claim how many first laps are completed in the same time as by other sources."""
    claims = []
    for source, name, fewer in (
        (ASSUMED, "the best assumed friction", 0.0),
        (HERE, "a reference that is told the friction under the vehicle", 2.0 / 30.0),
    ):
        gap = unknown_roads.frontier_gap(outcomes, source)
        if gap is not None:
            runs = len({o.seed for o in outcomes if o.experiment == unknown_roads.FIRST})
            text = f", or at most {fewer:.0%} of all runs fewer" if fewer else ""
            claims.append(
                Claim(
                    f"On a first lap it completes at least as many runs as {name} at equal time on "
                    f"the roads that both complete{text}",
                    gap[0] >= -fewer * runs,
                    f"at worst {gap[0]:+.1f} of {runs} ({gap[1]})",
                )
            )
    return claims


def _second_lap(outcomes: Sequence[Outcome]) -> list[Claim]:
    """Claim what remembering the first lap is worth on the second one."""
    holds: list[bool | None] = []
    evidence = []
    for risk in RISKS:
        contender = f"{BELIEF}{risk:.0%}"
        own = [o for o in outcomes if (o.experiment, o.contender) == (LATER, contender)]
        ratios = unknown_roads.lap_ratios(outcomes, contender)
        if own:
            begun, completed = (sum(len(o.lap_times) > lap for o in own) for lap in (0, 1))
            ratio = ratios[1].value if len(ratios) > 1 else math.nan
            # The oracle may have completed no run to compare with.
            known = None if math.isnan(ratio) else ratio <= _SECOND_LAP
            holds.append(known if completed == len(own) else False)
            evidence.append(
                f"{contender}: {completed} of {begun} second laps of {len(own)} runs"
                + ("" if math.isnan(ratio) else f", {ratio:.3f}")
            )
    if not holds:
        return []
    return [
        Claim(
            "At one of the risks every run completes the second lap, in at most "
            f"{_SECOND_LAP} times the oracle's time",
            any(holds) or (None if None in holds else False),
            "; ".join(evidence),
        )
    ]


def _within(group: Group, most: float) -> bool | None:
    """Whether all runs are completed in `most` times the oracle's time; None if that is unknown."""
    if group.completed < group.runs:
        return False
    time = group.time_regret.value
    return None if math.isnan(time) else time <= most


def _five_laps(outcomes: Sequence[Outcome]) -> list[Claim]:
    """Claim what the most careful risk costs over five laps."""
    careful = f"{BELIEF}{RISKS[0]:.0%}"
    through = [o for o in outcomes if o.completed]
    laps = ", ".join(f"{lap.value:.3f}" for lap in unknown_roads.lap_ratios(through, careful))
    return [
        Claim(
            f"Five laps from a cold start at a risk of {RISKS[0]:.0%} are completed, in at most "
            f"{_FIVE_LAPS} times the oracle's time",
            _within(group, _FIVE_LAPS),
            f"{group.completed} of {group.runs}, {group.time_regret.value:.3f}; laps {laps}",
        )
        for group in grouped(outcomes)
        if (group.experiment, group.contender) == (LATER, careful)
    ]


def _fleet(outcomes: Sequence[Outcome]) -> list[Claim]:
    """Claim what a map is worth to the second car, and what a wrong map costs beside two others."""
    own = [o for o in outcomes if o.experiment == fleet_roads.FLEET]
    groups = {group.contender: group for group in grouped(own)}
    claims = []
    if second := groups.get(fleet_roads.SECOND):
        time = second.time_regret
        claims.append(
            Claim(
                f"The second car completes every first lap, in at most {_SECOND_CAR} times the "
                "time of a reference that is told all zones",
                _within(second, _SECOND_CAR),
                f"{second.completed} of {second.runs}, {time.text('.3f', ' to ')}",
            )
        )
    outvoted, alone = (
        {o.seed: o.completed for o in own if o.contender == name}
        for name in (fleet_roads.OUTVOTED, fleet_roads.ALONE)
    )
    if seeds := sorted(outvoted.keys() & alone.keys()):
        lost = [seed for seed in seeds if alone[seed] and not outvoted[seed]]
        with_it, without = (sum(found[seed] for seed in seeds) for found in (outvoted, alone))
        where = f"; completed only without a map: seed {', '.join(map(str, lost))}" if lost else ""
        claims.append(
            Claim(
                "A wrong map beside those of two other cars costs no completed lap",
                not lost,
                f"{with_it} of {len(seeds)}, without a map {without}{where}",
            )
        )
    return claims


def _departures(outcomes: Sequence[Outcome]) -> list[Claim]:
    claims = []
    for experiment in REPLAYED:
        own = [
            o
            for o in outcomes
            if o.experiment == experiment
            and (o.contender.startswith(BELIEF) or experiment == fleet_roads.FLEET)
            and o.contender != ORACLE
        ]
        replayed = [o for o in own if o.avoidable is not None]
        avoidable = [o for o in replayed if o.avoidable]
        if own:
            where = ", ".join(f"{o.contender}, seed {o.seed}" for o in avoidable)
            source = (
                "control steps or a map" if experiment == fleet_roads.FLEET else "control steps"
            )
            claims.append(
                Claim(
                    f"No departure of {experiment} at a speed from what {source} found would "
                    "have been avoided by a controller that is told everything from the last "
                    "border on",
                    not avoidable,
                    f"{len(avoidable)} of {len(replayed)} departures in {len(own)} runs"
                    + (f": {where}" if where else ""),
                )
            )
    return claims


def _ice(outcomes: Sequence[IceOutcome]) -> list[Claim]:
    names = dict.fromkeys(o.contender for o in outcomes if o.contender.startswith(BELIEF))
    return [_ice_of(name, [o for o in outcomes if o.contender == name]) for name in names]


def _ice_of(name: str, own: Sequence[IceOutcome]) -> Claim:
    errors = [error for o in own for error in o.errors_after]
    within = sum(error <= LARGEST_ERROR for error in errors)
    worst = f", at worst {max(errors):.2f} m" if errors else ""
    on_first = sum(any(o.found[1:2]) for o in own)
    return Claim(
        "On the laps after a hidden patch of ice was found, the vehicle is never more than "
        f"{LARGEST_ERROR:g} m from the path ({name})",
        within == len(errors) if errors else None,
        f"{within} of {len(errors)} laps{worst}; found on the first lap "
        f"in {on_first} of {len(own)} runs; "
        f"{sum(not o.completed for o in own)} runs were not completed",
    )
