"""A controller whose replies come late or not at all, in simulated time.

The decisions are those of the driver in Rust, which both clients use, and the replies those of an
engine in this process. Only the network is simulated: it has a delay for each control period.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from egp_service._core import Decision, Driver, Engine
from egp_service.control.step import StepController
from egp_service.control.toml_text import dumps
from egp_service.simulation.scenario import gate_settings, library_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from egp_service._core import Query
    from egp_service.control.step import Measured
    from egp_service.simulation.scenario import Scenario

SLOWER = 1.0 + 1e-9  # a time that the driver sees as past


class LateReplies(StepController):
    """Answer the question of period k after `delays[k]` seconds, at once if k is beyond the end."""

    _driver: Driver

    def __init__(
        self, scenario: Scenario, delays: Sequence[float], *, budget: float, max_tail_ticks: int
    ) -> None:
        """Begin at the time 0; `budget` and `max_tail_ticks` are the client's settings."""
        super().__init__()
        self._engine = Engine(str(library_path(scenario)), dumps(scenario.control))
        self.library, self.members = self._engine.library_id, self._engine.members
        self.dt, self.horizon = self._engine.dt, self._engine.horizon
        self.history = self._engine.history
        gate = gate_settings(scenario) | {"max_tail_ticks": max_tail_ticks}
        self._driver = Driver(
            self._engine.ready, fleet="f", vehicle="v", gate=gate, budget=budget, hedge=1.0
        )
        self._driver.replica_appeared("main")
        self._driver.replica_fits("main")
        self._delays = delays
        self._period = 0
        self._under_way: list[tuple[float, int, bytes]] = []

    def _decide(self, start: float, budget: float, measured: Measured) -> Decision:
        del start  # the time is simulated
        now = self._period * self.dt
        deadline = now + budget
        delay = self._delays[self._period] if self._period < len(self._delays) else 0.0
        self._period += 1
        self._deliver(now)
        self._driver.tick(now, deadline, *measured)
        while True:
            while (action := self._driver.next_action()) is not None:
                if isinstance(action, Decision):
                    return action
                self._ask(action, now + delay)
            if not self._deliver(deadline):
                self._driver.wake(deadline * SLOWER)

    def _ask(self, query: Query, arrives: float) -> None:
        """Let the engine answer; the reply comes later."""
        asks_ready = query.key.endswith("/ready")
        reply = self._engine.ready if asks_ready else self._engine.step(query.payload)
        self._under_way.append((arrives, query.id, reply))

    def _deliver(self, until: float) -> bool:
        """Hand over the replies that have come; say whether there were any."""
        come = [one for one in self._under_way if one[0] <= until]
        self._under_way = [one for one in self._under_way if one[0] > until]
        for at, query, reply in come:
            self._driver.replied(at, query, reply, b"")
        return bool(come)
