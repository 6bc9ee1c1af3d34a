"""Transitions with the inputs that caused what was measured: columns moved in time by delays."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError
from egp_service.quantities import GP_INPUT

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset

_, _, _, DELTA, FORCE, DELTA_DOT = range(len(GP_INPUT))
_ROUNDING: Final = 1e-9  # periods


@dataclasses.dataclass(frozen=True)
class Delays:
    """How late the columns of a log are, in s."""

    measurement: float = 0.0
    """Time by which the measured `[v_x, v_y, omega]` are later than the steering angle."""
    force: float = 0.0
    """Time by which the measured `v_x` is later than the force; negative if the log's force is
    later than `v_x`, for instance a filtered measurement of the acceleration."""
    force_filter: float = 0.0
    """Time constant `T` in s of a first-order low-pass filter that the log's force has passed, as a
    force that was made from a filtered acceleration: `F = F_log + T dF_log/dt` acted."""


def align(dataset: Dataset, delays: Delays, kept: NDArray[np.bool_] | None = None) -> Dataset:
    """Return the transitions with steering angle and inputs of the time before the delays.

    A transition from `t` to `t + dt` gets `delta(t - d)` and the mean inputs between `t - d` and
    `t + dt - d`, with the delay `d` of each column. Steering angles are linear between the ends of
    periods, and forces are constant. The derivative that takes a filter back is that of forces that
    are linear between the middles of periods. States and changes stay as they were measured.
    Transitions that are not `available`, or not among those to be `kept` (n,), are left out.

    Raises:
        EgpError: if no transition is left.

    """
    if delays == Delays():
        return dataset if kept is None else dataset.select(kept)
    dt = dataset.provenance.dt
    late, late_force = delays.measurement / dt, delays.force / dt
    chosen = available(dataset, delays)
    if kept is not None:
        chosen &= kept
    inputs = []
    for rows in consecutive(dataset):
        n = len(rows)
        inside = chosen[rows]
        k, time = np.flatnonzero(inside).astype(np.float64), np.arange(n + 1, dtype=np.float64)
        z = dataset.z[rows]
        steering = np.append(z[:, DELTA], z[-1, DELTA] + dt * z[-1, DELTA_DOT])
        impulse = np.concatenate([[0.0], np.cumsum(z[:, FORCE])])
        moved = z[inside]
        moved[:, DELTA] = np.interp(k - late, time, steering)
        moved[:, DELTA_DOT] = (np.interp(k + 1.0 - late, time, steering) - moved[:, DELTA]) / dt
        moved[:, FORCE] = np.interp(k + 1.0 - late_force, time, impulse) - np.interp(
            k - late_force, time, impulse
        )
        if delays.force_filter > 0.0:
            at = np.interp([k - late_force, k + 1.0 - late_force], time[:-1] + 0.5, z[:, FORCE])
            moved[:, FORCE] += delays.force_filter / dt * (at[1] - at[0])
        inputs.append(moved)
    if not chosen.any():
        raise EgpError(
            f"no transition is left after moving the inputs by {delays.measurement:g} s and "
            f"{delays.force:g} s: expected longer trajectories"
        )
    return dataclasses.replace(dataset.select(chosen), z=np.concatenate(inputs))


def available(dataset: Dataset, delays: Delays) -> NDArray[np.bool_]:
    """Return whether the moved inputs of each transition (n,) lie in its run of consecutive ones.

    If they do for the ends of a range of delays, they do for all delays in between.
    """
    dt = dataset.provenance.dt
    late, late_force = delays.measurement / dt, delays.force / dt
    middle = 0.5 if delays.force_filter > 0.0 else 0.0
    earliest = max(late, late_force + middle, 0.0)
    latest = max(-late, middle - late_force, 0.0)
    runs = consecutive(dataset)
    after = np.concatenate([np.arange(len(rows)) for rows in runs])
    before_end = np.concatenate([np.arange(len(rows))[::-1] for rows in runs])
    return np.asarray((after - earliest >= -_ROUNDING) & (before_end - latest >= -_ROUNDING))


def consecutive(dataset: Dataset) -> list[NDArray[np.int64]]:
    """Return the rows of each run of consecutive transitions of a trajectory."""
    return np.split(np.arange(len(dataset)), np.flatnonzero(~dataset.follows) + 1)
