"""What not knowing the friction costs: lap times and departures of the reference speeds."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.evaluation.contenders import ORACLE, Contender
from egp_service.evaluation.experiment import TWO, ClosedLoopExperiment, jittered, on_surfaces
from egp_service.evaluation.statistics import median
from egp_service.simulation.scenario import Track

if TYPE_CHECKING:
    from collections.abc import Sequence

    from egp_service.evaluation.campaign import Outcome
    from egp_service.evaluation.statistics import Group, Interval

FIRST: Final = "unknown-roads"
LATER: Final = "remembered-roads"
# Sources of the reference speed's friction: what control steps found, one value everywhere, the
# friction under the vehicle, and that of the members as the weights blend them.
BELIEF: Final = "found, risk "
ASSUMED: Final = "assumed "
HERE: Final = "told here, "
WEIGHTED: Final = "weights, "
RISKS: Final = (0.03, 0.05, 0.1, 0.2)
# Lateral speed, m/s, and yaw rate, rad/s, within which plans should stay, so that vehicles that are
# too fast for a bend do not spin. The yaw rate is never reached.
ENVELOPE: Final[dict[str, object]] = {"soft": {"envelope": [3.0, 3.0]}}


# Random tracks, on which `DRAWN` gives each seed its zones, from ice to dry asphalt.
ROADS: Final = replace(
    on_surfaces(Track("random"), ((0.0, 1.0),), 0.9), leave_distance=3.5, control=ENVELOPE
)
DRAWN: Final = partial(jittered, frictions=(0.25, 1.1))


def informed(name: str, **speed: object) -> Contender:
    """Return the ensemble with a reference speed that has these fields of `Speed`."""
    return Contender(name, "ensemble", TWO, speed=speed)


def believing(risk: float) -> Contender:
    """Return the ensemble with a reference speed for what the control steps found."""
    return informed(f"{BELIEF}{risk:.0%}", knows="nothing", risk=risk)


def first_lap() -> ClosedLoopExperiment:
    """Return the experiment of one lap, for all sources of the friction."""
    return ClosedLoopExperiment(
        FIRST,
        "Roads of unknown friction, first lap (beyond the paper)",
        "The reference speed is not told the friction: what does each source of it cost in time, "
        "and how many laps end beside the road? The oracle is told all zones. Plans of all "
        "controllers stay within a lateral speed of 3 m/s.",
        (("first lap", ROADS),),
        (
            informed(ORACLE),
            *(believing(risk) for risk in RISKS),
            *(
                informed(f"{ASSUMED}{mu:g}", knows="nothing", friction=mu)
                for mu in (0.3, 0.35, 0.4, 0.5, 0.6)
            ),
            *(
                informed(
                    f"{HERE}{share:.0%} of it, at most {most:g}",
                    knows="here",
                    friction=most,
                    grip=0.9 * share,
                )
                for share, most in ((1.0, 1.1), (0.8, 1.1), (0.8, 0.5), (1.0, 0.4))
            ),
            *(
                informed(f"{WEIGHTED}{share:.0%} of it", knows="weights", grip=0.9 * share)
                for share in (1.0, 0.8)
            ),
        ),
        seeds=30,
        quick_seeds=1,
        road=DRAWN,
    )


def five_laps() -> ClosedLoopExperiment:
    """Return the experiment of five laps, for what the control steps found."""
    return ClosedLoopExperiment(
        LATER,
        "Roads of unknown friction, five laps (beyond the paper)",
        "What the first lap found is remembered by place: how fast do the next laps become? Plans "
        "of all controllers stay within a lateral speed of 3 m/s.",
        (("five laps", replace(ROADS, laps=5.0)),),
        (informed(ORACLE), *(believing(risk) for risk in RISKS[:3])),
        seeds=20,
        quick_seeds=1,
        road=DRAWN,
    )


def frontier_gap(outcomes: Sequence[Outcome], source: str) -> tuple[float, str] | None:
    """Return how many more first laps the belief completes than a `source` in equal time, at worst.

    `source` is `ASSUMED` or `HERE`. A variant of the source takes the median of the ratios of
    its lap time to that of a setting of the belief, over the seeds that both completed, so that
    a setting gains nothing from not completing slow roads. The completions of the variants, of
    which a slower one is never the worse choice, are interpolated over these ratios at 1. A
    setting that completes no run is compared with the best variant, and one that is faster than
    all variants, or has completed no road that a variant completed, is left out. Also returns
    the name of the worst setting. None if nothing can be compared.
    """
    times: dict[str, dict[int, float]] = {}
    for o in outcomes:
        if o.experiment == FIRST:
            completed = times.setdefault(o.contender, {})
            if o.completed:
                completed[o.seed] = o.time
    variants = [found for name, found in times.items() if name.startswith(source) and found]
    gaps = []
    for name, own in times.items():
        if not name.startswith(BELIEF) or not variants:
            continue
        if not own:
            gaps.append((-float(max(map(len, variants))), name))
        elif found := _paired_times(own, variants):
            ratios, completions = np.array(sorted(found), dtype=np.float64).T
            if ratios[0] <= 1.0:
                best = float(np.interp(1.0, ratios, np.maximum.accumulate(completions)))
                gaps.append((len(own) - best, name))
    return min(gaps, default=None)


def _paired_times(
    own: dict[int, float], variants: Sequence[dict[int, float]]
) -> list[tuple[float, int]]:
    """Return the median ratio of each variant's time to the own one, and its completed runs."""
    return [
        (float(np.median([found[seed] / own[seed] for seed in common])), len(found))
        for found in variants
        if (common := found.keys() & own.keys())
    ]


def lap_ratios(outcomes: Sequence[Outcome], contender: str) -> list[Interval]:
    """Return each lap's median ratio of the lap time to the oracle's, over the seeds.

    A seed counts for the laps that both completed.
    """
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
    """Return rows `source, completed, total, ratio of each lap` of the runs over several laps.

    All ratios are of the seeds that both completed; a source without one has dashes.
    """
    through = [o for o in outcomes if o.completed]
    own = [g for g in groups if g.experiment == LATER and g.contender != ORACLE]
    found = {
        g.contender: [f"{r.value:.3f}" for r in (g.time_regret, *lap_ratios(through, g.contender))]
        for g in own
        if np.isfinite(g.time_regret.value)
    }
    none = ["-"] * max(map(len, found.values()), default=1)
    return [(g.contender, f"{g.completed}/{g.runs}", *found.get(g.contender, none)) for g in own]


def departure_rows(groups: Sequence[Group], experiment: str) -> list[tuple[str, ...]]:
    """Return rows `source, departures, avoidable ones, others` of an experiment."""
    return [
        (g.contender, f"{g.avoidable + g.too_fast} of {g.runs}", str(g.avoidable), str(g.too_fast))
        for g in groups
        if g.experiment == experiment
    ]


def label(contender: str) -> str:
    """Return what tells a contender from the others of its source, for pictures."""
    text = contender.split(", ", 1)[-1]
    return text.replace(" of it, at most 1.1", "").replace("100% of it, at", "at")


def kind(contender: str) -> str:
    """Return the source of the friction, for legends."""
    for prefix, text in (
        (BELIEF, "found by the control steps"),
        (ASSUMED, "one friction assumed everywhere"),
        (HERE, "told the friction under the vehicle"),
        (WEIGHTED, "friction of the weights, no interval"),
    ):
        if contender.startswith(prefix):
            return text
    return "told all zones"
