"""Claims about the controller, checked against the outcomes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.evaluation import disturbances, road_claims
from egp_service.evaluation.claim import Claim
from egp_service.evaluation.contenders import ENSEMBLE, ORACLE
from egp_service.evaluation.experiments import EXACT, NARROW
from egp_service.evaluation.multiple_comparisons import LEVEL, holm, positive
from egp_service.evaluation.statistics import mean, paired
from egp_service.quantities import MOTION_LABELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from egp_service.evaluation.campaign import Outcome
    from egp_service.evaluation.hidden_ice import IceOutcome
    from egp_service.evaluation.prediction import PredictionOutcome

POOLED: Final = "A∪D"  # noqa: RUF001 - the union
COMPLETES: Final = (
    ("varying-speed", ("80% of grip", "90% of grip")),
    ("unseen-track", None),
    ("lane-change", None),
    ("four-members", None),
)
BEYOND: Final = ("random-roads", "hard-roads")
MIXED: Final = ("varying-speed", "unseen-track", "lane-change", "four-members", "random-roads")
_SHARE: Final = 0.95
_REGRET: Final = 1.2
_SETTLED: Final = 0.5  # s
_TIGHTENED: Final = 0.2
_EXCITED: Final = tuple(
    f"{acceleration} m/s² lateral{sensors}" for sensors in ("", EXACT) for acceleration in (2, 3, 4)
)


def check(
    outcomes: Sequence[Outcome],
    predictions: Sequence[PredictionOutcome],
    ice: Sequence[IceOutcome] = (),
) -> list[Claim]:
    """Check every claim for which there are outcomes."""
    claims = [
        *_completions(outcomes),
        *_beyond(outcomes),
        *_regret(outcomes),
        *_best(outcomes),
        *_settling(outcomes),
        *_narrow(outcomes),
        *_disturbances(outcomes),
        *road_claims.check(outcomes, ice),
    ]
    if predictions:
        claims += _ordering(predictions)
    return claims


def _completions(outcomes: Sequence[Outcome]) -> list[Claim]:
    claims = []
    for experiment, conditions in COMPLETES:
        runs = [
            o
            for o in outcomes
            if o.experiment == experiment
            and o.contender == ENSEMBLE
            and (conditions is None or o.condition in conditions)
        ]
        if runs:
            where = f" ({', '.join(conditions)})" if conditions else ""
            through = sum(o.completed for o in runs)
            claims.append(
                Claim(
                    f"The ensemble completes {experiment}{where} in all runs",
                    through == len(runs),
                    f"{through} of {len(runs)}",
                )
            )
    return claims


def _beyond(outcomes: Sequence[Outcome]) -> list[Claim]:
    runs = [o for o in outcomes if o.experiment in BEYOND]
    oracle = {
        (o.experiment, o.condition, o.seed) for o in runs if o.contender == ORACLE and o.completed
    }
    own = [
        o for o in runs if o.contender == ENSEMBLE and (o.experiment, o.condition, o.seed) in oracle
    ]
    if not own:
        return []
    through = sum(o.completed for o in own)
    return [
        Claim(
            f"It completes at least {_SHARE:.0%} of the runs beyond the paper that the oracle does",
            through >= _SHARE * len(own),
            f"{through} of {len(own)}",
        )
    ]


def _narrow(outcomes: Sequence[Outcome]) -> list[Claim]:
    """Compare the ensemble with the best caution, which is the best on these same outcomes."""
    runs = [o for o in outcomes if o.experiment == NARROW]
    own = {
        name: [o for o in runs if o.contender == name]
        for name in dict.fromkeys(o.contender for o in runs)
        if name != ORACLE
    }
    over = {name: float(np.mean([o.off_track for o in found])) for name, found in own.items()}
    plain = over.pop(ENSEMBLE, None)
    if not over or plain is None:
        return []
    best = min(over, key=lambda name: over[name])
    through = {name: sum(o.completed for o in own[name]) for name in (ENSEMBLE, best)}
    # A vehicle that is lost early has little time over the edge.
    lost = through[best] < through[ENSEMBLE]
    return [
        Claim(
            f"Tightened edges reduce the time over the edge of a narrow track to {_TIGHTENED:.0%}",
            (not lost and over[best] <= _TIGHTENED * plain) if plain > 0.0 else None,
            f"{plain:.2f} s without, {over[best]:.2f} s with {best}, the best of "
            f"{len(over)} by the same runs; completed {through[ENSEMBLE]} and {through[best]}",
        )
    ]


def _disturbances(outcomes: Sequence[Outcome]) -> list[Claim]:
    found = disturbances.compare(outcomes, ENSEMBLE, disturbances.FITTED)
    if not found:
        return []
    closer = [comparison.condition for comparison in found if comparison.closer]
    others = [comparison.condition for comparison in found if not comparison.closer]
    evidence = (("closer", closer), ("not closer", others))
    return [
        Claim(
            "Under at least half of the disturbances the ensemble is closer to the path than the "
            "fitted vehicles of its members alone, at 90 % of the grip and beyond a 95 % interval "
            "of the mean difference",
            2 * len(closer) >= len(found),
            "; ".join(f"{text}: {', '.join(names)}" for text, names in evidence if names),
        )
    ]


def _regret(outcomes: Sequence[Outcome]) -> list[Claim]:
    told = {
        (o.experiment, o.condition, o.seed): o.lateral_rms
        for o in outcomes
        if o.contender == ORACLE and o.completed
    }
    found: dict[str, list[float]] = {}
    for o in outcomes:
        key = (o.experiment, o.condition, o.seed)
        if o.experiment in MIXED and o.contender == ENSEMBLE and key in told:
            # No ratio is small enough for a vehicle that is lost where the oracle's is not.
            ratio = o.lateral_rms / told[key] if o.completed else np.inf
            found.setdefault(f"{o.experiment}, {o.condition}", []).append(ratio)
    if not found:
        return []
    ratios = {where: float(np.median(values)) for where, values in found.items()}
    worst = max(ratios, key=lambda name: ratios[name])
    return [
        Claim(
            f"Its lateral RMS error is at most {_REGRET} times the oracle's on mixed friction",
            ratios[worst] <= _REGRET,
            f"worst median ratio {ratios[worst]:.2f} ({worst})",
        )
    ]


def _best(outcomes: Sequence[Outcome]) -> list[Claim]:
    """Compare completions first, then errors of the same seeds; road and noise are a seed's own."""
    groups: dict[tuple[str, str], dict[str, list[Outcome]]] = {}
    for o in outcomes:
        if o.experiment in MIXED and o.contender != ORACLE:
            here = groups.setdefault((o.experiment, o.condition), {})
            here.setdefault(o.contender, []).append(o)
    compared = [
        (f"{experiment}, {condition}: {name}", comparison)
        for (experiment, condition), found in groups.items()
        for name, other in found.items()
        if name != ENSEMBLE and (comparison := paired(condition, other, found.get(ENSEMBLE, [])))
    ]
    if not compared:
        return []
    rejected = holm([positive(comparison.gains) for _, comparison in compared])
    lost = [
        f"{where} by {comparison.gain.value * 1000:.1f} mm" if closer else where
        for (where, comparison), closer in zip(compared, rejected, strict=True)
        if comparison.completed[0] > comparison.completed[1]
        or (closer and comparison.completed[0] == comparison.completed[1])
    ]
    # With too few seeds no difference, however clear, can be a finding.
    decided = any(0.5 ** len(one.gains) <= LEVEL / len(compared) for _, one in compared)
    return [
        Claim(
            "No other controller but the oracle completes more runs, or as many and drives closer, "
            "on mixed friction (Wilcoxon's signed-rank test of the lateral RMS errors, seed by "
            f"seed, with Holm's correction for {len(compared)} comparisons at {LEVEL:.0%})",
            not lost if lost or decided else None,
            "; ".join(lost) or ("in none" if decided else "too few seeds that both completed"),
        )
    ]


def _settling(outcomes: Sequence[Outcome]) -> list[Claim]:
    claims = []
    for condition in _EXCITED:
        own = [
            outcome
            for outcome in outcomes
            if outcome.experiment == "friction-step"
            and outcome.contender == ENSEMBLE
            and outcome.condition == condition
        ]
        times = [time for outcome in own for time in outcome.settling]
        if not own:
            continue
        moved = sum(bool(outcome.settling) for outcome in own)
        found = f"{moved} of {len(own)} runs have a step that moved the weights"
        holds = False
        if times:
            median, late = float(np.median(times)), float(np.percentile(times, 90))
            found = f"median {median:.2f} s, 90 % within {late:.2f} s; {found}"
            holds = moved >= _SHARE * len(own) and late <= _SETTLED
        claims.append(
            Claim(
                f"Weights settle within {_SETTLED} s of a friction step under {condition}",
                holds,
                found,
            )
        )
    return claims


def _ordering(predictions: Sequence[PredictionOutcome]) -> list[Claim]:
    """Compare as in the paper's figure: ensemble, pooled, wrong surface; two to four members."""

    def error(predictor: str, on: str, window: int) -> NDArray[np.float64]:
        rows = [
            p.rmse
            for p in sorted(predictions, key=lambda p: p.seed)
            if (p.predictor, p.tested_on, p.window) == (predictor, on, window)
        ]
        return np.array(rows)

    ensemble, pooled = error("E(AD)", POOLED, 1), error(POOLED, POOLED, 0)
    # On the union, whose halves are of the same size.
    other = np.sqrt(0.5 * (error("A", "D", 0) ** 2 + error("D", "A", 0) ** 2))
    two, three, four = (error(f"E({m})", "T", 1) for m in ("AD", "ABD", "ABCD"))
    return [
        *_ordered(
            "The ensemble predicts better than the pooled GP, that better than the wrong surface's",
            ((ensemble, pooled), (pooled, other)),
        ),
        *_ordered(
            "On unseen friction three members predict better than two, four better than three",
            ((three, two), (four, three)),
        ),
    ]


def _ordered(
    text: str, pairs: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]
) -> list[Claim]:
    """Claim the order for each seed, and significantly for each output's mean over the seeds."""
    gaps = np.concatenate([more - less for less, more in pairs], axis=1)
    every = np.all(gaps > 0.0, axis=1)
    claims = [
        Claim(
            f"{text}, in every seed and output",
            bool(every.all()),
            f"{int(every.sum())} of {len(every)} seeds",
        )
    ]
    if len(gaps) > 1:  # one seed has no spread
        means = [mean(gap) for gap in gaps.T]
        outputs = len(MOTION_LABELS)
        least = [min(means[o::outputs], key=lambda gap: gap.low) for o in range(outputs)]
        found = [
            f"{name} {gap.text('.4f', ' to ')}"
            for name, gap in zip(MOTION_LABELS, least, strict=True)
        ]
        claims.append(
            Claim(
                f"{text}, in the mean over the seeds",
                all(gap.low > 0.0 for gap in least),
                f"narrowest gaps: {', '.join(found)}",
            )
        )
    return claims
