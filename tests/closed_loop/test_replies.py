"""The replies to every request of recorded runs: same bits everywhere, same plans by Clarabel.

Clarabel is asked for 1e-12. At its default of 1e-9 it passes, too, but for the lost car: there the
cost goes into the ten thousands and its gap is relative to that, so that one plan in eight is off
by more than 1e-6, at worst 2e-3 (first inputs 1e-8). Tightened it comes to our plans: measured
worst 4e-9 on the lap, 2e-10 over the drop in friction. For the lost car first inputs agree to 2e-7,
but 5 of 1968 plans are off by more than 1e-6 somewhere, at worst 3e-2 at the end, where Clarabel's
residual stalls at 3e-9 while ours is 2e-12.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import zenoh

from egp_service import Controller
from egp_service._core import Engine, decode_reply, step_key
from egp_service.closed_loop import drive
from egp_service.scenario import (
    Measurement,
    Scenario,
    Speed,
    Track,
    Zone,
    library_path,
    load_scenario,
)
from egp_service.service_process import ServiceProcess

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from egp_service.stepper import Step

# Of inputs in m/s^2 and rad/s.
TOLERANCE = 1e-6
STALLED = 0.005  # of the plans
SCALE = np.array([1225.887, 1.0])
LAP = load_scenario("rounded-rectangle")
DROP = replace(
    LAP,
    track=Track("circle", parameters={"radius": 30.0}),
    zones=(Zone(0.0, 1.1), Zone(0.5, 0.5)),
    speed=Speed(grip=0.85, v_max=30.0),
    measurement=Measurement(0.02, 0.05, 0.005, 0.05, 0.02, 0.002),
)
LOST = replace(DROP, speed=Speed(grip=1.0, v_max=30.0), leave_distance=30.0)
RUNS = {"a lap": LAP, "a drop in friction": DROP, "a lost car": LOST}
LIBRARY = library_path(LAP)


class Patient(Controller):
    """Grants every step five seconds, so that a busy service refuses none."""

    def step(
        self,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        *,
        deadline: float | None = None,
    ) -> Step:
        """Give the command."""
        del deadline
        return super().step(x, reference, widths, deadline=5.0)


@pytest.fixture(scope="module", params=RUNS)
def requests(request: pytest.FixtureRequest) -> list[bytes]:
    recorded: list[bytes] = []
    scenario: Scenario = RUNS[request.param]
    with Patient(LIBRARY) as controller:
        drive(scenario, controller, lambda period: recorded.append(period.step.request))
    assert len(recorded) > 500
    return recorded


def test_clarabel_finds_the_same_plans(requests: list[bytes]) -> None:
    fast = Engine(str(LIBRARY))
    oracle = Engine(str(LIBRARY), '[solver]\nkind = "clarabel"\ntolerance = 1e-12')
    first, whole = [], []
    for request in requests:
        ours, other = decode_reply(fast.step(request)), decode_reply(oracle.step(request))
        assert (ours.status, other.status) == ("solved", "solved")
        np.testing.assert_array_equal(ours.weights, other.weights)
        difference = np.abs((ours.plan_u - other.plan_u) / SCALE)
        first.append(difference[0].max())
        whole.append(difference.max())
    assert np.max(first) <= TOLERANCE
    assert np.mean(np.array(whole) > TOLERANCE) <= STALLED


def test_another_engine_and_the_service_reply_with_the_same_bytes(requests: list[bytes]) -> None:
    engine, other = Engine(str(LIBRARY)), Engine(str(LIBRARY))
    replies = [engine.step(request) for request in requests]
    # Backwards: nothing is left in an engine from one request to the next.
    assert [other.step(request) for request in reversed(requests)] == replies[::-1]
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("mode", '"client"')
    with ServiceProcess(LIBRARY, {}) as service:
        config.insert_json5("connect/endpoints", f'["{service.endpoint}"]')
        with zenoh.open(config) as session:
            key = step_key("main", "fleet", "car")
            for request, reply in zip(requests, replies, strict=True):
                (served,) = list(session.get(key, payload=request))
                assert served.ok is not None
                assert served.ok.payload.to_bytes() == reply
