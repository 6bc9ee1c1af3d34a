"""Departures replayed by a controller that is told everything.

A replay drives the same run again, which gives the same states bit for bit, up to the last border
between surfaces before the departure. From there on the weights are those of the oracle, and the
reference speed is planned for the true friction of all zones from the present place and speed on.
If the replay stays on the road, the departure was avoidable: the vehicle was not too fast for a
controller. If the replay leaves the road, too, or spins, the vehicle came too fast, and only a more
careful reference speed avoids this. A replay that ends otherwise decides nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service.evaluation.contenders import Oracle
from egp_service.simulation.closed_loop import STOPPED, TOO_LONG, drive

if TYPE_CHECKING:
    from collections.abc import Callable

    from egp_service._core import RoadBelief
    from egp_service.evaluation.contenders import Contender
    from egp_service.simulation.closed_loop import Run

# m from the path; at a border where the vehicle is farther off, the departure has already begun.
_HELD: Final = 0.5
# m that a replay drives beyond the place of the departure.
_BEYOND: Final = 100.0


def departed(run: Run) -> bool:
    """Whether the vehicle left the road or spun."""
    ending = run.summary.ending
    return not ending.completed and not ending.reason.startswith((TOO_LONG, STOPPED))


def last_border(run: Run) -> int:
    """Return the number of the last period before a border that was crossed near the path.

    Without such a border it is 0, the start of the run.
    """
    trace = run.trace
    before = np.flatnonzero(np.diff(trace.friction) != 0.0)
    held = before[np.abs(trace.lateral_error[before]) <= _HELD]
    return int(held[-1]) if len(held) else 0


def replay(contender: Contender, run: Run, belief: RoadBelief | None = None) -> Run:
    """Drive a run on a closed track again, from `last_border` on with everything told.

    It is completed if the vehicle stays on the road until 100 m beyond the end of `run`. What the
    vehicle knew about the road before the run is its `belief`.
    """
    told_from = last_border(run)
    laps = (run.summary.ending.distance + _BEYOND) / run.path.length
    scenario = replace(run.scenario, laps=laps)
    weights_from = 0 if contender.kind == "oracle" else told_from
    controller = Oracle(scenario, weights_from)
    return drive(scenario, controller, lambda _: None, belief, told_from)


def avoidable(
    contender: Contender, run: Run, known: Callable[[], RoadBelief | None] = lambda: None
) -> bool | None:
    """Whether a replay avoids the departure of `run`; None if the run has no departure.

    It is also None if the replay neither completes nor departs, which tells nothing. `known` gives
    what the vehicle knew about the road before the run.
    """
    if not departed(run):
        return None
    told = replay(contender, run, known())
    if departed(told):
        return False
    return True if told.summary.ending.completed else None
