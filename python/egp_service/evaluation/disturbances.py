"""Disturbances that a single-track vehicle cannot have: what Gaussian processes bring there."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from egp_service.evaluation.contenders import ENSEMBLE, Contender
from egp_service.evaluation.experiment import (
    CUSTOM_TRACK,
    LAP_ZONES,
    NOISE,
    TWO,
    ClosedLoopExperiment,
    on_surfaces,
)
from egp_service.evaluation.statistics import Comparison, Interval, paired
from egp_service.simulation.scenario import Disturbances

if TYPE_CHECKING:
    from collections.abc import Sequence

    from egp_service.evaluation.campaign import Outcome

NAME: Final = "disturbances"
FITTED: Final = "fitted single-track"
ELSEWHERE: Final = ", undisturbed data"
"""Suffix of contenders whose members are those of the vehicle without the disturbance."""
WITH_RESIDUAL: Final = ", residual"
"""Suffix of contenders whose control step adds a residual to its members."""
RESIDUAL: Final = {
    # In m/s, m/s and rad/s over a period of 0.02 s: half of what a bank of 0.1 rad brings.
    "std": [0.01, 0.01, 0.002],
    "time": [1.0, 1.0, 1.0],
    "noise": [0.003, 0.003, 0.001],
    "measurement": [NOISE.v_x, NOISE.v_y, NOISE.omega],
}
"""The settings of this residual: chosen, but for the noise of the sensors, and not fitted."""
DISTURBED: Final = {
    "load of 300 kg, 0.6 m left": Disturbances(load=300.0, load_y=0.6),
    "rear tyres worn by 15 %": Disturbances(wear_rear=0.15),
    "brakes pull left by 50 %": Disturbances(brake_pull=0.5),
    "wind of 15 m/s": Disturbances(wind_y=15.0, wind_arm=0.5),
    "uphill by 0.1 rad": Disturbances(grade=0.1),
    "banked by 0.06 rad": Disturbances(bank=0.06),
}
# Suffix of conditions that leave the vehicle more grip than its disturbance takes away.
GENTLE: Final = ", 80% of grip"
# A library of a disturbance has the members of these two surfaces only.
_OWN_MEMBERS: Final = (0, 1)


def experiment() -> ClosedLoopExperiment:
    """Return the experiment: each disturbance at 90 and 80 % of the grip, on three surfaces."""
    bases = {
        where: on_surfaces(CUSTOM_TRACK, LAP_ZONES, g) for where, g in (("", 0.9), (GENTLE, 0.8))
    }
    return ClosedLoopExperiment(
        NAME,
        "Disturbances that a fitted vehicle cannot have (beyond the paper)",
        "The members are trained on data of the vehicle with its disturbance, with and without "
        "Gaussian processes: which of them is closer to the path, at 90 % of the grip unless "
        "stated? The other controllers have the members of the vehicle without the disturbance, "
        "which were trained on more data; the last one also estimates a residual online.",
        tuple(
            (name + where, replace(base, disturbances=found))
            for where, base in bases.items()
            for name, found in DISTURBED.items()
        ),
        (
            Contender(ENSEMBLE, "ensemble", _OWN_MEMBERS, disturbed=True),
            Contender(FITTED, "fitted", _OWN_MEMBERS, disturbed=True),
            Contender(ENSEMBLE + ELSEWHERE, "ensemble", TWO, variant=True),
            Contender(FITTED + ELSEWHERE, "fitted", TWO),
            Contender(
                ENSEMBLE + ELSEWHERE + WITH_RESIDUAL,
                "ensemble",
                TWO,
                control={"residual": RESIDUAL},
                variant=True,
            ),
        ),
        seeds=20,
        quick_seeds=0,
    )


def compare(
    outcomes: Sequence[Outcome], first: str, second: str, where: str = ""
) -> list[Comparison]:
    """Compare two contenders under each disturbance for which both have outcomes.

    The conditions are those with the suffix `where`: none for 90 % of the grip, or `GENTLE`.
    """
    found = []
    for condition in (name + where for name in DISTURBED):
        one, other = (
            [
                o
                for o in outcomes
                if (o.experiment, o.condition, o.contender) == (NAME, condition, contender)
            ]
            for contender in (first, second)
        )
        if comparison := paired(condition, one, other):
            found.append(comparison)
    return found


def rows(outcomes: Sequence[Outcome]) -> list[tuple[str, ...]]:
    """Return rows `disturbance, gains by processes, own data and the residual` in mm."""
    own, *others = (
        {
            c.condition: _millimetres(c)
            for where in ("", GENTLE)
            for c in compare(outcomes, *pair, where)
        }
        for pair in (
            (ENSEMBLE, FITTED),
            (ENSEMBLE, ENSEMBLE + ELSEWHERE),
            (ENSEMBLE + ELSEWHERE + WITH_RESIDUAL, ENSEMBLE + ELSEWHERE),
        )
    )
    return [(name, gain, *(other.get(name, "-") for other in others)) for name, gain in own.items()]


def _millimetres(comparison: Comparison) -> str:
    gain, (first, second) = comparison.gain, comparison.completed
    text = Interval(1e3 * gain.value, 1e3 * gain.low, 1e3 * gain.high).text("+.2f", " to ")
    if math.isnan(gain.value):
        text = "no seed that both completed"
    if min(first, second) < comparison.runs:
        text += f", completed {first} and {second} of {comparison.runs}"
    return text
