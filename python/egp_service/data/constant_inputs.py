"""Simulated vehicles that start in given states and keep their inputs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import VehicleLostError
from egp_service.data.dataset import Dataset
from egp_service.quantities import DELTA, NY, NZ, OMEGA, V_X, V_Y

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service.data.experiment import Experiment, SimulatedVehicle

_VISIBLE: Final = (V_X, V_Y, OMEGA, DELTA)  # columns of the state
_STANDSTILL: Final = 0.5  # m/s; slower vehicles count as standing


def drive(
    experiment: Experiment,
    start: NDArray[np.float64],
    inputs: NDArray[np.float64],
    periods: tuple[int, int],
    method: str,
    *,
    sideslip: float = math.inf,
) -> Dataset | None:
    """Drive vehicles from states (count, 7) with the inputs (count, 2), and keep the last periods.

    `periods` are the numbers of those that are driven before, in which suspension and tyres reach
    their state, and of those that are kept. Vehicles that spin or stop, or whose angle between
    heading and course exceeds `sideslip` (rad), are left out; None if all are. `method` is that of
    the provenance.
    """
    settle, keep = periods
    vehicle = experiment.simulated()
    driven = [
        _drive(experiment, vehicle, x, u, settle + keep, sideslip=sideslip)
        for x, u in zip(start, inputs, strict=True)
    ]
    alive = [number for number, states in enumerate(driven) if states is not None]
    survivors = len(alive)
    if survivors == 0:
        return None
    visible = np.array([states for states in driven if states is not None])[:, settle:, _VISIBLE]
    repeated = np.repeat(inputs[alive][:, None, :], keep, axis=1)
    z = np.concatenate([visible[:, :-1], repeated], axis=2)
    return Dataset(
        z=z.reshape(-1, NZ),
        y=np.diff(visible[:, :, :NY], axis=1).reshape(-1, NY),
        trajectory=np.repeat(np.arange(survivors, dtype=np.uint32), keep),
        step=np.tile(np.arange(keep, dtype=np.uint32), survivors),
        provenance=experiment.provenance(method),
    )


def _drive(
    experiment: Experiment,
    vehicle: SimulatedVehicle,
    x: NDArray[np.float64],
    u: NDArray[np.float64],
    periods: int,
    *,
    sideslip: float,
) -> NDArray[np.float64] | None:
    """Drive from the state x (7,) with the input u (2,); return the states (periods + 1, 7).

    None if the vehicle spun, stopped, or slipped by more than `sideslip`.
    """
    vehicle.reset(x)
    states = [vehicle.state]
    for _ in range(periods):
        try:
            vehicle.step(u, experiment.dt, experiment.friction)
        except VehicleLostError:
            return None
        states.append(vehicle.state)
        v_x, v_y = states[-1][V_X], states[-1][V_Y]
        if v_x <= _STANDSTILL or abs(math.atan2(v_y, v_x)) > sideslip:
            return None
    return np.array(states)
