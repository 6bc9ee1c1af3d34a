"""What the monitor keeps of vehicles and replicas, from the messages that they publish."""

from __future__ import annotations

import json
import math
import time as clock
from array import array
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from google.protobuf.message import DecodeError

from egp_service.control.messages import message_class
from egp_service.monitor.vehicle import MODES, Json, VehicleRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from google.protobuf.message import Message

FORGET_SECONDS: Final = 600.0
"""Vehicles, and replicas without a token, that were not seen for this time leave the page."""
_LOAD_SECONDS: Final = 1.25
"""A replica publishes its load twice a second by default; after this time without one it counts as
silent, or after `_LOADS` times the time between its last two loads if that is longer."""
_LOADS: Final = 3
_VERSION: Final = 1
_EVENTS: Final = 200
_NAMED: Final = 3
_MOST_VEHICLES: Final = 1000
"""A further vehicle takes the place of one that ended, or of the longest silent one. Without such a
vehicle its messages are ignored, so that strangers cannot fill the memory."""
_ROOM_SECONDS: Final = 1.0
"""Time between two looks for such a place."""
_LARGEST: Final = (64, 64, 258, 64)
"""Largest numbers of weights, members, coordinates of the plan and times of periods in a message;
vehicles send no more."""
_LONGEST_NAME: Final = 64
"""Longest name of a replica; the protocol permits no longer one."""
_LONGEST_TEXT: Final = 256
"""What is kept of another text of a message, characters."""
LARGEST_STATUS: Final = 1 << 16
"""Longest message of a vehicle, bytes; the filters of `egp keys` have the same bound."""
LARGEST_ROAD: Final = 1 << 20
"""Longest message that describes a road, bytes; 25 000 points take less."""
_ROAD: Final = ("left_x", "left_y", "right_x", "right_y", "friction")
_MOST_POINTS: Final = 25_000
"""Most points of a road; `egp drive` tells one for each metre."""
_MOST_REPLICAS: Final = 1000
"""A further replica with a token takes the place of one without, and otherwise its messages are
ignored, too."""
_MOST_TOKENS: Final = 10_000
"""Tokens that are remembered."""


@dataclass(slots=True)
class Replica:
    """A replica of the service."""

    name: str
    alive: bool
    last_seen: float
    load: Json
    loaded: float | None = None
    """When the last load came, if one came since the token appeared."""
    interval: float = 0.0
    """Time between the last two loads, s; 0 before there were two."""

    def state(self, now: float) -> str:
        """Give `serving`, `silent` or `gone`."""
        if not self.alive:
            return "gone"
        longest = min(max(_LOAD_SECONDS, _LOADS * self.interval), FORGET_SECONDS)
        return "silent" if now - self.last_seen > longest else "serving"

    def row(self, now: float) -> Json:
        """Give what the page shows."""
        age = round(max(now - self.last_seen, 0.0), 1)
        return {"name": self.name, "state": self.state(now), "age": age, **self.load}


def _is_replaceable(vehicle: VehicleRecord, now: float) -> bool:
    return vehicle.state(now) in ("ended", "silent")


class Fleet:
    """Vehicles and replicas by name; times are those of the monotonic clock, in s."""

    def __init__(self) -> None:
        """Begin without vehicles and replicas."""
        self.vehicles: dict[str, VehicleRecord] = {}
        self.replicas: dict[str, Replica] = {}
        self.events: deque[Json] = deque(maxlen=_EVENTS)
        self.happened = 0
        self._states: dict[tuple[str, str], str] = {}
        self._looked = self._full = -math.inf
        # Vehicles that had ended or were silent at the last look, the first to be replaced last.
        self._replaceable: list[str] = []
        # Replicas whose liveliness tokens are there, each of which is told once.
        self._tokens: set[str] = set()

    def status(self, name: str, payload: bytes, now: float) -> None:
        """Keep a vehicle's message `VehicleStatus`.

        A message is ignored if it is too long, cannot be decoded, is of another version, has no
        control period or an unknown mode, or names a replica as no replica can be named. Unknown
        fields are not kept, and long texts are cut.
        """
        if len(payload) > LARGEST_STATUS:
            return
        status = _decoded("VehicleStatus", payload)
        if status is None or status.version != _VERSION:
            return
        status.DiscardUnknownFields()
        if not (math.isfinite(status.dt) and status.dt > 0.0 and status.step.mode in MODES):
            return
        lists = (status.step.weights, status.members, status.plan, status.times)
        if any(len(values) > most for values, most in zip(lists, _LARGEST, strict=True)):
            return
        if len(status.step.replica) > _LONGEST_NAME:
            return
        for field in ("status", "detail"):
            setattr(status.step, field, getattr(status.step, field)[:_LONGEST_TEXT])
        status.members[:] = [member[:_LONGEST_TEXT] for member in status.members]
        known = self.vehicles.get(name)
        if known is not None:
            known.add(status, now)
        elif self._has_room(now):
            self.vehicles[name] = VehicleRecord(name, status, now)

    def _has_room(self, now: float) -> bool:
        """Make room for a further vehicle, if one has ended or is silent."""
        if len(self.vehicles) < _MOST_VEHICLES:
            return True
        if not self._replaceable and now - self._looked >= _ROOM_SECONDS:
            self._looked = now
            gone = [v for v in self.vehicles.values() if _is_replaceable(v, now)]
            gone.sort(key=lambda v: (not v.status.ended, v.last_seen), reverse=True)
            self._replaceable = [v.name for v in gone]
        while self._replaceable:
            name = self._replaceable.pop()
            if name in self.vehicles and _is_replaceable(self.vehicles[name], now):
                del self.vehicles[name]
                return True
        return False

    def road(self, name: str, payload: bytes) -> None:
        """Keep the road of a vehicle, a message `VehicleRoad` of finite numbers.

        One of another version or of more than 25 000 points is ignored.
        """
        road = _decoded("VehicleRoad", payload)
        if road is None:
            return
        found = {name: getattr(road, name) for name in _ROAD}
        lengths = {len(column) for column in found.values()}
        current = road.version == _VERSION
        whole = len(lengths) == 1 and max(lengths) <= _MOST_POINTS
        if name not in self.vehicles or not (current and whole):
            return
        columns = {name: array("d", found[name]) for name in _ROAD}
        if all(math.isfinite(value) for column in columns.values() for value in column):
            self.vehicles[name].road = columns

    def load(self, name: str, payload: bytes, now: float) -> None:
        """Keep a replica's message `Load`."""
        load = _decoded("Load", payload)
        replica = None if load is None else self._replica(name, now)
        if load is None or replica is None:
            return
        if replica.loaded is not None:
            replica.interval = now - replica.loaded
        replica.alive, replica.last_seen, replica.loaded = True, now, now
        replica.load = {
            "queued": load.queued,
            "busy": load.busy,
            "workers": load.workers,
            "step_ms": round(1e-3 * load.step_us, 2),
        }

    def token(self, name: str, now: float, *, appeared: bool) -> None:
        """Note that a replica's liveliness token appeared or disappeared."""
        if not appeared:
            self._tokens.discard(name)
        elif len(self._tokens) < _MOST_TOKENS:
            self._tokens.add(name)
        replica = self._replica(name, now)
        if replica is not None:
            replica.alive = appeared
            replica.last_seen = now
            replica.loaded, replica.interval = None, 0.0

    def _replica(self, name: str, now: float) -> Replica | None:
        """Return the replica of this name, or None if there is no place for it."""
        if name not in self.replicas and len(self.replicas) >= _MOST_REPLICAS:
            if name not in self._tokens or now - self._full < _ROOM_SECONDS:
                return None
            others = [replica for n, replica in self.replicas.items() if n not in self._tokens]
            if not others:
                self._full = now
                return None
            # One that never had a token goes before one that is gone.
            del self.replicas[min(others, key=lambda r: (not r.alive, r.last_seen)).name]
        return self.replicas.setdefault(name, Replica(name, alive=True, last_seen=now, load={}))

    def update(self, now: float) -> None:
        """Note changes of state as events, and forget what was not seen for long.

        A replica whose token is there is kept, however rarely it publishes its load.
        """
        for name in _unseen(self.vehicles.items(), now):
            del self.vehicles[name]
        unannounced = [(n, r) for n, r in self.replicas.items() if n not in self._tokens]
        for name in _unseen(unannounced, now):
            del self.replicas[name]
        changed: dict[tuple[str, str], list[str]] = {}
        states: dict[tuple[str, str], str] = {}
        for kind, records in (("replica", self.replicas), ("vehicle", self.vehicles)):
            for name, record in records.items():
                state = states[kind, name] = record.state(now)
                if self._states.get((kind, name)) != state:
                    changed.setdefault((kind, state), []).append(name)
        self._states = states
        for (kind, state), names in changed.items():
            self._tell(kind, state, names)

    def _tell(self, kind: str, state: str, names: list[str]) -> None:
        listed = ", ".join(names[:_NAMED])
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        event: Json = {"at": round(clock.time(), 1), "kind": kind, "state": state}
        self.events.append(event | {"names": listed + more, "number": self.happened})
        self.happened += 1

    def snapshot(self, now: float) -> str:
        """Give the rows of all vehicles and replicas as JSON."""
        serves: dict[str, int] = {}
        rows = [vehicle.row(now) for vehicle in self.vehicles.values()]
        for row in rows:
            if row["state"] in {"normal", "tail"}:
                serves[str(row["replica"])] = serves.get(str(row["replica"]), 0) + 1
        replicas = [
            replica.row(now) | {"vehicles": serves.get(replica.name, 0)}
            for replica in self.replicas.values()
        ]
        return json.dumps({"now": round(now, 3), "vehicles": rows, "replicas": replicas})


def _decoded(name: str, payload: bytes) -> Message | None:
    """Return a message of this name, or None if the bytes are none."""
    try:
        return message_class(name).FromString(payload)
    except DecodeError:
        return None


def _unseen(
    records: Iterable[tuple[str, VehicleRecord]] | Iterable[tuple[str, Replica]], now: float
) -> Iterator[str]:
    """Give the names of records that are to be forgotten."""
    yield from [name for name, record in records if now - record.last_seen > FORGET_SECONDS]
