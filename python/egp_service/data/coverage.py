"""What a dataset covers: duration, gaps, ranges, and the time at each speed and acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import STANDARD_GRAVITY
from egp_service.quantities import GP_INPUT

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from egp_service.data.dataset import Dataset

SPEEDS: Final = np.array([0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, np.inf])
"""Borders of the bins of v_x, m/s."""
LATERAL: Final = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, np.inf])
"""Borders of the bins of the lateral acceleration, the magnitude of v_x omega, m/s²."""
THIN: Final = 2.0
"""Time in s below which a bin has too few data to train on."""
# Share of the grip from which cornering tells the friction.
_GRIP: Final = 0.6
_LEAST: Final = 5.0  # s


@dataclass(frozen=True)
class Coverage:
    """What a dataset covers."""

    seconds: float
    """Time of all transitions."""
    trajectories: int
    longest: float
    """Time of the longest trajectory, s. Logs are split into trajectories of at most 10 s."""
    gaps: tuple[float, ...]
    """Lengths in s of the gaps of the imported logs."""
    ranges: dict[str, tuple[float, float, str]]
    """Smallest and largest value of each GP input, and its unit."""
    time: NDArray[np.float64]
    """Time in s in each bin of `SPEEDS` (rows) and `LATERAL` (columns)."""
    at_grip: float
    """Time in s of cornering with more than 60 % of the grip that the surface's friction gives."""

    @classmethod
    def of(cls, dataset: Dataset) -> Coverage:
        """Count the time of a dataset's transitions."""
        dt = dataset.provenance.dt
        z = dict(zip(GP_INPUT, dataset.z.T, strict=True))
        lateral = np.abs(z["v_x"] * z["omega"])
        speed = np.maximum(z["v_x"], 0.0)
        count, _, _ = np.histogram2d(speed, lateral, bins=(SPEEDS, LATERAL))
        _, lengths = np.unique(dataset.trajectory, return_counts=True)
        limit = _GRIP * dataset.provenance.friction * STANDARD_GRAVITY
        return cls(
            seconds=dt * len(dataset),
            trajectories=len(lengths),
            longest=dt * float(lengths.max()),
            gaps=dataset.gaps,
            ranges={
                name: (float(z[name].min()), float(z[name].max()), unit)
                for name, unit in GP_INPUT.items()
            },
            time=dt * count,
            at_grip=dt * float(np.sum(lateral > limit)),
        )

    def lines(self) -> Iterator[str]:
        """Say what is covered, and what is too thin to train on."""
        noun = "trajectory" if self.trajectories == 1 else "trajectories"
        total, longest = (
            f"{time:.3g}" if time < 100.0 else f"{time:.0f}"  # noqa: PLR2004 - no exponent
            for time in (self.seconds, self.longest)
        )
        yield f"{total} s in {self.trajectories} {noun} of at most {longest} s"
        if self.gaps:
            noun = "gap" if len(self.gaps) == 1 else "gaps"
            yield (
                f"{len(self.gaps)} {noun} of {sum(self.gaps):.3g} s in total, "
                f"the longest of {max(self.gaps):.3g} s"
            )
        yield ", ".join(
            f"{name} {low:.3g} to {high:.3g} {unit}"
            for name, (low, high, unit) in self.ranges.items()
        )
        if self.at_grip < _LEAST:
            yield (
                f"thin: {self.at_grip:.1f} s of cornering with more than {_GRIP:.0%} of the grip; "
                "members will not predict the tyres' limits, and the data do not tell the friction"
            )
        turning = self.time[:, 1:].sum(axis=1)
        for row in np.flatnonzero((self.time.sum(axis=1) >= THIN) & (turning < THIN)):
            yield (
                f"thin: {turning[row]:.1f} s of cornering above {LATERAL[1]:g} m/s² at "
                f"{span(SPEEDS, int(row))} m/s"
            )


def span(borders: NDArray[np.float64], number: int) -> str:
    """Name a bin by its borders."""
    low, high = borders[number : number + 2]
    return f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} and more"
