"""What only tests and benchmarks call: parts of plant, solver, gate and wire by themselves.

Its names are not those of `egp_service._core`, and may change at any time.
"""

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Final, Literal, Self, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from egp_service._core.plant import Plant

MAP_HEALTH_KEY: str
MAP_METRICS_KEY: str

@final
class Command:
    u: Final[tuple[float, float]]
    mode: Final[Literal["normal", "tail", "stop", "waiting"]]
    limited: Final[bool]

@final
class Gate:
    def __new__(cls, dt: float, settings: Mapping[str, float]) -> Gate: ...
    def accept(
        self, tick: int, plan_u: Sequence[tuple[float, float]] | NDArray[np.float64]
    ) -> None: ...
    def command(self, tick: int, v_x: float, delta: float) -> Command: ...
    def reset(self) -> None: ...
    @property
    def mode(self) -> Literal["normal", "tail", "stop", "waiting"]: ...

@final
class Refusal:
    code: Final[
        Literal[
            "unspecified",
            "malformed",
            "version",
            "invalid_field",
            "unknown_library",
            "overloaded",
            "superseded",
            "too_late",
            "draining",
            "unauthenticated",
            "internal",
        ]
    ]
    retryable: Final[bool]
    retry_after_us: Final[int]
    field: Final[str]
    detail: Final[str]

@final
class MapServer:
    def __new__(cls, config_toml: str) -> MapServer: ...
    def stop(self) -> None: ...
    def __enter__(self) -> Self: ...
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None: ...

def plant_derivative(
    state: ArrayLike,
    u: ArrayLike,
    friction: float | NDArray[np.float64],
    vehicle: int = 1,
) -> NDArray[np.float64]: ...
def plant_initial_states(
    vehicle_states: NDArray[np.float64], vehicle: int = 1
) -> NDArray[np.float64]: ...
def plant_lateral_acceleration(plant: Plant) -> float: ...
def decode_error(data: bytes) -> Refusal: ...
def decode_timing(data: bytes) -> tuple[int, int]: ...
def step_key(replica: str, fleet: str, vehicle: str) -> str: ...
def ready_key(replica: str) -> str: ...
def live_key(replica: str) -> str: ...
