"""What a simulated car measured along the road of the scenario *random*."""

from __future__ import annotations

import numpy as np

from egp_service._core import RoadBelief
from egp_service.simulation.course import build_path
from egp_service.simulation.scenario import load_scenario

PATH = build_path(load_scenario("random"))
FRICTIONS = 0.1 * 13.0 ** np.linspace(0.0, 1.0, 17)


def measured(friction: float, metres: float = 150.0) -> RoadBelief:
    belief = RoadBelief(PATH)
    measure(belief, friction, metres)
    return belief


def measure(belief: RoadBelief, friction: float, metres: float) -> None:
    row = -0.5 * (np.log(FRICTIONS / friction) / 0.05) ** 2
    for s in np.arange(0.0, metres, 0.2):
        belief.update(s, row - row.max())
