"""Checks of a log against motions that no road vehicle makes, though each value is plausible."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import STANDARD_GRAVITY, EgpError
from egp_service.data.plausibility import MOVING, largest, runs

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from egp_service.data.log_import import Column

    Log = Mapping[str, NDArray[np.float64]]

# g; racing cars with aerodynamic downforce reach 5 to 6.
_LARGEST_LATERAL: Final = 6.0
# Share of the rows in which a motion may be impossible: single rows are wrong in logs of real cars.
_OUTLIERS: Final = 0.005
# If the steering angle jumps, and is exactly constant for this time before or after the jump, its
# sensor has failed. An angle that is constant for shorter times only has a coarse resolution.
_HELD: Final = 0.5
_SHORTEST: Final = 0.02  # s


def check(log: Log, columns: Mapping[str, Column], wheelbase: float | None = None) -> None:
    """Check a log in SI units; `columns` are those it was read from, `wheelbase` in m if known.

    Raises:
        EgpError: naming the columns, the rows and the likely mistake.

    """
    _check_lateral(log, columns)
    _check_steering(log, columns, largest("delta_dot", wheelbase))


def _check_lateral(log: Log, columns: Mapping[str, Column]) -> None:
    """Check the lateral acceleration of a steady bend, the speed times the yaw rate."""
    moving = log["v_x"] > MOVING
    if not moving.any():
        return
    lateral = np.abs(log["v_x"] * log["omega"])[moving] / STANDARD_GRAVITY
    reached = float(np.quantile(lateral, 1.0 - _OUTLIERS))
    if reached > _LARGEST_LATERAL:
        speed, omega = columns["v_x"], columns["omega"]
        raise EgpError(
            f"'{speed.name}' in {speed.unit} times '{omega.name}' in {omega.unit} exceeds "
            f"{reached:.1f} g in {_OUTLIERS:.1%} of the rows in motion: more than "
            f"{_LARGEST_LATERAL:g} g is implausible. Check both units, and whether '{omega.name}' "
            f"and '{columns['v_y'].name}' are swapped"
        )


def _check_steering(log: Log, columns: Mapping[str, Column], most: float) -> None:
    """Check how fast the steering angle changes, as a stated `delta_dot` is checked."""
    name = columns["delta"].name
    delta, periods = log["delta"], np.diff(log["time"])
    rate = np.abs(np.diff(delta)) / np.maximum(periods, _SHORTEST)
    fast = rate > most
    if fast.mean() > _OUTLIERS:
        raise EgpError(
            f"'{name}' changes faster than {most:g} rad/s in {fast.mean():.1%} of the rows, "
            "which no steering does: check its unit, add --steering-ratio if it is the steering "
            "wheel's angle, or smooth it"
        )
    period = float(np.median(periods))
    for first, last in runs(delta):
        duration = (last - first) * period
        if duration < _HELD or not fast[max(first - 1, 0) : last].any():
            continue
        if np.median(log["v_x"][first:last]) > MOVING:
            raise EgpError(
                f"'{name}' stays at {delta[first]:.4g} rad from row {first} to {last - 1}, "
                f"{duration:.1f} s, and jumps there by more than {most:g} rad/s, which no "
                "steering does: the sensor probably failed; remove these rows, or name the column "
                "of the measured angle if this is a command"
            )
