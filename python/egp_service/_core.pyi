"""Types of the compiled extension, one section per Rust file under `rust/python/src`."""

from collections.abc import Mapping, Sequence
from typing import Literal, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Command",
    "EgpError",
    "FrictionMap",
    "Gate",
    "Plant",
    "plant_derivative",
    "plant_initial_states",
    "plant_step_batch",
]

# error.rs

class EgpError(ValueError):
    """A refused input or a failed computation; the message says what was expected and what came."""

# gate.rs

@final
class Command:
    """What leaves the gate in one period."""

    @property
    def u(self) -> tuple[float, float]:
        """Force [N] and steering rate [rad/s]."""
    @property
    def mode(self) -> Literal["normal", "tail", "stop"]:
        """Where it comes from."""
    @property
    def limited(self) -> bool:
        """Whether a limit changed what the plan asked for."""

@final
class Gate:
    """NORMAL → TAIL (rest of the last plan) → STOP (brakes, latched), with hard limits."""

    def __new__(cls, dt: float, settings: Mapping[str, float] = ...) -> Gate: ...
    def accept(
        self, tick: int, plan_u: Sequence[tuple[float, float]] | NDArray[np.float64]
    ) -> None:
        """Take a plan of (T, 2) inputs whose first one is meant for period `tick`."""
    def command(self, tick: int, v_x: float, delta: float) -> Command:
        """Give what the actuators get in period `tick`, at this measured speed and angle."""
    def reset(self) -> None:
        """Leave STOP and forget the old plan."""
    @property
    def mode(self) -> Literal["normal", "tail", "stop"]:
        """Where the last command came from."""

# plant.rs

@final
class Plant:
    """A simulated vehicle: the 29-state multi-body vehicle of the CommonRoad benchmarks.

    `vehicle` is its CommonRoad number: 1 a Ford Escort, 2 a BMW 320i. Starts at rest in the origin.
    """

    def __new__(cls, vehicle: int = 1) -> Plant: ...
    def reset(
        self,
        x: float,
        y: float,
        yaw: float,
        v: float,
        yaw_rate: float = 0.0,
        v_y: float = 0.0,
        delta: float = 0.0,
    ) -> None:
        """Put the vehicle somewhere at forward speed `v >= 0`, its suspension at rest."""

    def step(self, u: NDArray[np.float64], dt: float, friction: float | FrictionMap) -> None:
        """Drive `dt` seconds under the constant input `u = [F_x, delta_dot]` (N, rad/s).

        Raises `EgpError` for refused input and when the vehicle has spun, and keeps the state then.
        """

    @property
    def state(self) -> NDArray[np.float64]:
        """All 29 states in the order of CommonRoad's multi-body vehicle."""

    @state.setter
    def state(self, value: NDArray[np.float64]) -> None: ...
    @property
    def vehicle_state(self) -> NDArray[np.float64]:
        """What a controller sees: `[p_x, p_y, v_x, psi, v_y, omega, delta]`, SI units."""

    @property
    def mass(self) -> float:
        """In kg."""

    @property
    def lateral_acceleration(self) -> float:
        """Lateral acceleration of the body in m/s²."""

@final
class FrictionMap:
    """Friction coefficients `values` (rows along +y, columns along +x) in square cells.

    `origin` is the lower left corner of the grid, `cell` a cell's side in m. The border
    continues outside.
    """

    def __new__(
        cls, values: NDArray[np.float64], origin: tuple[float, float], cell: float
    ) -> FrictionMap: ...

def plant_derivative(
    state: NDArray[np.float64],
    u: NDArray[np.float64],
    friction: float | NDArray[np.float64],
    vehicle: int = 1,
) -> NDArray[np.float64]:
    """Right-hand side of the 29 differential equations.

    `friction` is one coefficient or four: front -y, front +y, rear -y, rear +y, with y to the left.
    """

def plant_initial_states(
    vehicle_states: NDArray[np.float64], vehicle: int = 1
) -> NDArray[np.float64]:
    """Full states (n, 29) for `[p_x, p_y, v_x, psi, v_y, omega, delta]` rows (n, 7)."""

def plant_step_batch(
    states: NDArray[np.float64],
    u: NDArray[np.float64],
    dt: float,
    friction: NDArray[np.float64],
    vehicle: int = 1,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Drive n vehicles `dt` seconds on all cores without the GIL.

    States (n, 29), inputs (n, 2), friction (n,). Returns the new states and which
    vehicles completed the period; one that spun keeps its state.
    """
