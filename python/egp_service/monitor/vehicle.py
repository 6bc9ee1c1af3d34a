"""What the monitor keeps of one vehicle."""

from __future__ import annotations

import math
from array import array
from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from google.protobuf.message import Message

Json = dict[str, object]
MODES: Final = ("normal", "tail", "stop", "waiting")
"""Modes of a vehicle's step."""
SILENT_SECONDS: Final = 1.0
"""A vehicle counts as silent after this time without a message, or after `_PERIODS` if longer."""
_PERIODS: Final = 3
_LONGEST_PERIOD: Final = 1.0
"""The longest period that a library can have, s."""
WINDOW_SECONDS: Final = 60.0
"""Misses and the 99 % quantile of the step's time cover this time of control periods."""
_MOST_PERIODS: Final = 12_000
_SAMPLES: Final = 600
# Places in a sample; the weights follow `_MISSED`.
_MODE: Final = 1
_MISSED: Final = 18
_QUANTILE_SECONDS: Final = 1.0
_ROAD_ATTEMPTS: Final = 3
_ROAD_SECONDS: Final = 2.0


class VehicleRecord:
    """One vehicle: its newest message, the times of its last minute, and samples for curves.

    All times are those of the monitor's monotonic clock at reception, in s.
    """

    def __init__(self, name: str, status: Message, now: float) -> None:
        """Begin with the first message of a vehicle, `name` being `fleet/vehicle`."""
        self.name = name
        self.road: dict[str, array[float]] | None = None
        self.last_seen = now
        self._begin(status)
        self.add(status, now)

    def _begin(self, status: Message) -> None:
        """Forget an earlier run of the vehicle."""
        self._run = status.run
        kept = min(max(math.ceil(WINDOW_SECONDS / max(status.dt, 1e-3)), 1), _MOST_PERIODS)
        # Rings with the time of a step in ms, and whether it missed, for the newest periods.
        self._totals = np.zeros(kept, dtype=np.float32)
        self._missed = np.zeros(kept, dtype=np.bool_)
        self._periods = 0
        self._p99: float | None = None
        self._p99_at = -math.inf
        self._samples: deque[array[float]] = deque(maxlen=_SAMPLES)
        self.sampled = 0
        self.road = None
        self._road_asked = 0
        self._road_next = 0.0

    def add(self, status: Message, now: float) -> None:
        """Keep a message that came at `now`."""
        if status.run != self._run:
            self._begin(status)
        self.status = status
        self.last_seen = now
        for times in status.times:
            place = self._periods % self._totals.size
            self._totals[place], self._missed[place] = times.total_ms, times.missed
            self._periods += 1
        if not status.ended:
            self._samples.append(_sample(status, now))
            self.sampled += 1

    def wants_road(self, now: float) -> bool:
        """Whether the road is to be asked for now; a vehicle need not publish one."""
        due = self.road is None and self._road_asked < _ROAD_ATTEMPTS and now >= self._road_next
        if due:
            self._road_asked += 1
            self._road_next = now + _ROAD_SECONDS
        return due

    def state(self, now: float) -> str:
        """Give `normal`, `tail`, `stop`, `waiting`, `silent` or `ended`."""
        if self.status.ended:
            return "ended"
        period = min(self.status.dt, _LONGEST_PERIOD)
        if now - self.last_seen > max(SILENT_SECONDS, _PERIODS * period):
            return "silent"
        mode: str = self.status.step.mode
        return mode

    def row(self, now: float) -> Json:
        """Give the vehicle's row in the list of the fleet."""
        kept = min(self._periods, self._totals.size)
        if now - self._p99_at >= _QUANTILE_SECONDS:
            self._p99_at = now
            self._p99 = float(np.percentile(self._totals[:kept], 99)) if kept else None
        status = self.status
        return {
            "id": self.name,
            "state": self.state(now),
            "age": round(max(now - self.last_seen, 0.0), 1),
            "misses": int(np.count_nonzero(self._missed[:kept])),
            "periods": kept,
            "tails": status.tails,
            "p99": number(self._p99, 1),
            "deadline": number(status.deadline_ms, 1),
            "replica": status.step.replica,
        }

    def detail(self, since: int) -> tuple[Json, int]:
        """Give what a page draws of the vehicle, with the samples after number `since`."""
        status = self.status
        new = min(self.sampled - since, len(self._samples))
        samples = list(self._samples)[len(self._samples) - new :] if new else []
        whole = all(map(math.isfinite, status.plan))
        detail: Json = {
            "id": self.name,
            "run": str(self._run),
            "members": list(status.members),
            "deadline": number(status.deadline_ms, 1),
            "dt": status.dt,
            "status": status.step.status,
            "reason": status.step.detail,
            "limited": status.step.limited,
            "lost": status.step.lost,
            "envelope": number(status.step.envelope_distance, 2),
            "plan": [round(value, 2) for value in status.plan] if whole else [],
            "samples": [_row(sample) for sample in samples],
        }
        return detail, self.sampled


def _sample(status: Message, now: float) -> array[float]:
    """Give the numbers of one message in the order that `page/samples.js` names.

    They take a quarter of the memory of lists. NaN stands for none, and the weights come last.
    """
    step, truth = status.step, status.truth
    simulated = status.HasField("truth")
    slowest = max(status.times, key=lambda times: times.total_ms, default=None)
    numbers = [
        round(now, 3),
        MODES.index(step.mode),
        number(step.p_x, 2),
        number(step.p_y, 2),
        number(step.psi, 4),
        number(step.v_x, 2),
        number(truth.speed_reference, 2) if simulated else None,
        number(status.lateral_error, 3),
        number(step.force, 0),
        number(step.steering_rate, 3),
        number(step.friction_mean, 3),
        number(step.friction_lower, 3),
        number(step.friction_upper, 3),
        number(step.friction_information, 2),
        number(truth.friction, 3) if simulated else None,
        number(slowest.total_ms, 2) if slowest else None,
        number(slowest.queue_ms, 2) if slowest else None,
        number(slowest.compute_ms, 2) if slowest else None,
        any(times.missed for times in status.times),
        *(number(weight, 3) for weight in step.weights),
    ]
    return array("d", [math.nan if value is None else value for value in numbers])


def _row(sample: array[float]) -> list[object]:
    """Give a sample as the page reads it."""
    values = [None if math.isnan(value) else value for value in sample]
    mode, missed = MODES[int(sample[_MODE])], bool(sample[_MISSED])
    return [
        *values[:_MODE], mode, *values[_MODE + 1 : _MISSED], missed, values[_MISSED + 1 :],
    ]  # fmt: skip


def number(value: float | None, digits: int) -> float | None:
    """Round for JSON, which has no number for NaN and infinity."""
    return None if value is None or not math.isfinite(value) else round(value, digits)
