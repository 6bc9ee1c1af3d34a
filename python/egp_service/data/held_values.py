"""Check of transitions for values of a slower sensor, which were held until the next ones came.

The changes of such a column are zero in some periods, and those of several periods in others, so
that neither describes the vehicle.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError
from egp_service.quantities import GP_STATE_NAMES, NY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset
    from egp_service.data.log_import import Column

# Share of the periods in which a held column keeps its value; 30 Hz in rows of 50 Hz give 0.4.
_SHARE: Final = 0.38
# Least number of changes next to a repeated value, which tell held values from coarse ones.
_CHANGES: Final = 50
# A coarse column repeats a value where it changes slowly, and its changes there are single quanta.
# Those of a held column differ: their median is at least `_SPREAD` times the quantile `_SMALLEST`.
_SPREAD: Final = 3.0
_SMALLEST: Final = 0.05
# Share of the largest speed below which the vehicle counts as standing.
_STANDING: Final = 0.1


def check(data: Dataset, columns: Mapping[str, Column]) -> None:
    """Check the transitions of a log, whose changes still contain those due to gravity.

    Raises:
        EgpError: naming the columns of `v_x`, `v_y` and `omega` whose values are held, the share
            of the periods in which they are, and a period that is long enough.

    """
    moving = data.z[:, 0] > _STANDING * data.z[:, 0].max(initial=0.0)
    force = np.diff(data.z[:, NY + 1], prepend=data.z[:1, NY + 1])
    changes = np.column_stack([data.y, data.z[:, NY + 2], force])
    shares = {
        columns[quantity].name: share
        for number, quantity in enumerate(GP_STATE_NAMES[:NY])
        if (share := _share(changes, number, moving)) >= _SHARE
    }
    if not shares:
        return
    first, *others = sorted(shares, key=lambda name: -shares[name])
    dt, share = data.provenance.dt, shares[first]
    alike = "".join(f" and '{name}'" for name in others)
    raise EgpError(
        f"'{first}' keeps its value in {share:.0%} of the periods of {dt:g} s in which other "
        f"columns change: its sensor is slower, and its values were held. Interpolate '{first}'"
        f"{alike} between the rows with new values, or state a longer period, such as "
        f"--dt {dt * round(1.0 / (1.0 - share)):.6g}"
    )


def _share(changes: NDArray[np.float64], number: int, moving: NDArray[np.bool_]) -> float:
    """Return the share of the periods in which a column is held, and 0 if it is not."""
    kept = changes[:, number] == 0.0
    counted = moving & (np.delete(changes, number, axis=1) != 0.0).any(axis=1)
    beside = np.zeros_like(kept)
    beside[1:] |= kept[:-1]
    beside[:-1] |= kept[1:]
    sizes = np.abs(changes[moving & beside & ~kept, number])
    if len(sizes) < _CHANGES or np.median(sizes) < _SPREAD * np.quantile(sizes, _SMALLEST):
        return 0.0
    return float(kept[counted].mean()) if counted.any() else 0.0
