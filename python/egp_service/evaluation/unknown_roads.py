"""What not knowing the friction costs: lap times and departures of the reference speeds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.evaluation.contenders import ORACLE
from egp_service.evaluation.experiments import ASSUMED, BELIEF, HERE
from egp_service.evaluation.statistics import median

if TYPE_CHECKING:
    from collections.abc import Sequence

    from egp_service.evaluation.campaign import Outcome
    from egp_service.evaluation.statistics import Group, Interval

FIRST: Final = "unknown-roads"
LATER: Final = "remembered-roads"


def frontier_gap(groups: Sequence[Group], source: str) -> tuple[float, str] | None:
    """Return by how many completed runs the belief exceeds a `source` at equal time, at worst.

    `source` is `ASSUMED` or `HERE`. Between the source's variants its completions are interpolated
    over the time, and a slower setting of the belief is compared with the best of them; settings
    that are faster than all of them are left out.
    Also returns the worst setting's name. None if nothing can be compared.
    """
    own = [g for g in groups if g.experiment == FIRST and np.isfinite(g.time_regret.value)]
    others = sorted(
        (g.time_regret.value, g.completed) for g in own if g.contender.startswith(source)
    )
    if not others:
        return None
    times, completed = np.array(others, dtype=np.float64).T
    best = np.maximum.accumulate(completed)  # a slower variant is never the worse choice
    gaps = [
        (g.completed - float(np.interp(g.time_regret.value, times, best)), g.contender)
        for g in own
        if g.contender.startswith(BELIEF) and times[0] <= g.time_regret.value
    ]
    return min(gaps, default=None)


def lap_ratios(outcomes: Sequence[Outcome], contender: str) -> list[Interval]:
    """Return each lap's median ratio of the lap time to the oracle's, over the seeds."""
    told = {o.seed: o for o in outcomes if (o.experiment, o.contender) == (LATER, ORACLE)}
    own = [o for o in outcomes if (o.experiment, o.contender) == (LATER, contender)]
    laps = max((len(o.lap_times) for o in own), default=0)
    return [
        median(
            [
                o.lap_times[lap] / told[o.seed].lap_times[lap]
                for o in own
                if o.seed in told and lap < min(len(o.lap_times), len(told[o.seed].lap_times))
            ]
        )
        for lap in range(laps)
    ]


def lap_rows(groups: Sequence[Group], outcomes: Sequence[Outcome]) -> list[tuple[str, ...]]:
    """Return rows `source, completed, total, ratio of each lap` of the runs over several laps."""
    rows = []
    for group in groups:
        if group.experiment == LATER and group.contender != ORACLE:
            ratios = [f"{ratio.value:.3f}" for ratio in lap_ratios(outcomes, group.contender)]
            rows.append(
                (
                    group.contender,
                    f"{group.completed}/{group.runs}",
                    f"{group.time_regret.value:.3f}",
                    *ratios,
                )
            )
    return rows


def kind(contender: str) -> str:
    """Return the source of the friction, for legends."""
    for prefix, text in (
        (BELIEF, "found by the control steps"),
        (ASSUMED, "one friction assumed everywhere"),
        (HERE, "told the friction under the vehicle"),
    ):
        if contender.startswith(prefix):
            return text
    return "told all zones"
