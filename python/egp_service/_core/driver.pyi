"""The driver's state machine."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from egp_service._core.wire import Friction

@final
class Query:
    id: Final[int]
    replica: Final[str]
    key: Final[str]
    payload: Final[bytes]
    attachment: Final[bytes]
    listen: Final[float]

@final
class Decision:
    u: Final[NDArray[np.float64]]
    mode: Final[Literal["normal", "tail", "stop", "waiting"]]
    limited: Final[bool]
    status: Final[str]
    detail: Final[str]
    lost: Final[bool]
    envelope_distance: Final[float]
    plan_x: Final[NDArray[np.float64] | None]
    plan_u: Final[NDArray[np.float64] | None]
    sigma: Final[NDArray[np.float64] | None]
    friction: Final[Friction | None]
    replica: Final[str]
    request: Final[bytes]
    reply: Final[bytes | None]
    late: Final[list[bytes]]
    service_time: Final[tuple[float, float]]
    held_up: Final[int]

@final
class Driver:
    def __new__(
        cls,
        ready: bytes,
        *,
        fleet: str,
        vehicle: str,
        gate: Mapping[str, float],
        budget: float = 0.8,
        hedge: float = 0.5,
        want_sigma: bool = False,
        keys: str | None = None,
        traces: Path | None = None,
        traces_share: float = 1.0,
    ) -> Driver: ...
    def replica_appeared(self, replica: str) -> None: ...
    def replica_fits(self, replica: str) -> None: ...
    def replica_gone(self, now: float, replica: str) -> None: ...
    def tick(
        self,
        now: float,
        deadline: float,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        road_friction: ArrayLike | None = None,
    ) -> None: ...
    def clock(self, now: float) -> None: ...
    def abandon(self) -> None: ...
    @property
    def next_wake(self) -> float: ...
    def wake(self, now: float) -> None: ...
    def replied(self, now: float, query: int, payload: bytes, attachment: bytes) -> None: ...
    def refused(self, now: float, query: int, error: bytes) -> None: ...
    def ended(self, now: float, query: int) -> None: ...
    def next_action(self) -> Query | Decision | None: ...
    def finish_traces(self) -> tuple[int, str | None]: ...
    @property
    def budget(self) -> float: ...
    @property
    def weights(self) -> NDArray[np.float64]: ...
    def reset(self) -> None: ...

@final
class Discovery:
    def __new__(
        cls,
        *,
        fleet: str,
        vehicle: str,
        gate: Mapping[str, float],
        budget: float = 0.8,
        hedge: float = 0.5,
        keys: str | None = None,
    ) -> Discovery: ...
    def replica_appeared(self, replica: str) -> None: ...
    def replica_gone(self, replica: str) -> None: ...
    @property
    def live(self) -> list[str]: ...
    def next_question(self) -> tuple[str, str, bytes] | None: ...
    def is_usable(self, replica: str, answer: bytes, attachment: bytes) -> bool: ...
    @property
    def error(self) -> str: ...
    @property
    def unusable(self) -> dict[str, str]: ...
