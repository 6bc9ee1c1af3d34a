"""The simulated vehicle, and the surfaces that it drives on."""

from collections.abc import Mapping
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from egp_service._core.path import Path, _Surface
from egp_service._core.vehicle import VehicleParameters

@final
class Plant:
    """A simulated vehicle: the 29-state multi-body vehicle of the CommonRoad benchmarks.

    `vehicle` is its number as for `VehicleParameters.commonroad`. It starts at rest in the origin.
    `disturbances` are those of `egp_service.simulation.scenario.Disturbances` by name,
    0 unless stated.

    Raises:
        InvalidArgumentError: if a name is unknown or a value out of its range.

    """

    def __new__(
        cls, vehicle: int = 1, disturbances: Mapping[str, float] | None = None
    ) -> Plant: ...
    def reset(
        self,
        x: float,
        y: float,
        yaw: float,
        v: float,
        *,
        yaw_rate: float = 0.0,
        v_y: float = 0.0,
        delta: float = 0.0,
    ) -> None:
        """Put the vehicle at `x`, `y` (m) and `yaw` (rad) with rolling wheels.

        It gets the forward speed `v` and the lateral speed `v_y` (m/s), the yaw rate `yaw_rate`
        (rad/s) and the steering angle `delta` (rad); its suspension is at rest.

        Raises:
            InvalidArgumentError: if a number is not finite, and unless `v` is from 0 to 100 m/s,
                `v_y` within ±50 m/s, `yaw_rate` within ±20 rad/s and `delta` within ±1.5 rad. The
                state is then unchanged.

        """
    def step(
        self,
        u: ArrayLike,
        dt: float,
        friction: _Surface | Path,
        hint: float | None = None,
    ) -> None:
        """Drive `dt` seconds, at most 100, with the constant input `u` (2,), `[F_x, delta_dot]`.

        The units are N and rad/s.

        The surface is the same everywhere, or that of the path's zone under each wheel. Wheels are
        located on a path as by `Path.project`: pass the last projection's `s`, m, as `hint`, or
        each call searches the whole path.

        Raises:
            InvalidArgumentError: for a surface that is unknown, and for an input, a period, a
                surface or a hint that is not finite or out of range; the state is then unchanged.
            TypeError: for what is neither a surface nor a path.
            VehicleLostError: if the vehicle has spun; the state is then unchanged.

        """
    @property
    def state(self) -> NDArray[np.float64]:
        """All states (29,) in the order and the SI units of CommonRoad's multi-body vehicle.

        Raises:
            InvalidArgumentError: if they are set with another shape, a number that is not finite,
                or a forward speed that is not from 0 to 100 m/s.

        """
    @state.setter
    def state(self, value: ArrayLike) -> None: ...
    @property
    def vehicle_state(self) -> NDArray[np.float64]:
        """The state (7,) for a controller: `[p_x, p_y, v_x, psi, v_y, omega, delta]`.

        In m, m, m/s, rad, m/s, rad/s and rad.
        """
    @property
    def parameters(self) -> VehicleParameters:
        """The parameters for a controller of this vehicle."""
    @property
    def mass(self) -> float:
        """Mass of the simulated vehicle in kg, which `parameters` states rounded."""

def surface_friction(surface: _Surface) -> float:
    """Return the friction coefficient of a surface: longitudinal peak force over load.

    A surface is this number alone, above 0 and at most 3, a preset (`dry`, `wet`, `snow`, `ice`),
    or a table with `peak` and factors on the tyre's `stiffness`, `shape` and `curvature`, all 1
    unless stated. The lateral force has a peak of `0.9 peak` and the same factors, unless
    `lateral_peak`, `lateral_stiffness`, `lateral_shape` or `lateral_curvature` state others.
    `shift` is a factor on the lateral force of camber alone.

    Raises:
        InvalidArgumentError: if a name is unknown or a value out of its range.
        TypeError: for what is no number, name or table of numbers.

    """
