"""Belief about the friction along a road, and the speed that it allows."""

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from egp_service._core.path import Path, SpeedProfile
from egp_service._core.vehicle import VehicleParameters

FRICTION_HYPOTHESES: tuple[float, ...]
"""The 17 friction coefficients from 0.1 to 1.3 to which the elements of a `log_likelihood` belong.

They increase.
"""

@final
class RoadBelief:
    """Belief about the friction along a path, from what control steps found by place.

    The path is divided into cells of equal length, at most 2 m.

    From cell to cell the friction stays or, on average every 200 m, is drawn anew from a uniform
    distribution over 0.1 to 1.3. The vehicle cannot react to what lies less than 45 m ahead: with
    the probability of a change within this distance plans assume that a place is on a patch, about
    which only evidence measured within 8 m counts. A cell keeps logarithms of likelihood ratios up
    to 6 nats, and a window does not tell coefficients apart whose logarithms differ by up to 0.25
    nats. `window` is the number of transitions from which a step estimates the friction. `scale`
    multiplies all lengths named here; it is 1 for full-size vehicles, and for smaller ones their
    `VehicleParameters.scale`. Only beliefs of the same scale exchange tiles and files, so use the
    nearest power of two if vehicles of nearly the same size share what they find.

    Raises:
        InvalidArgumentError: unless the window is 1 to 1000, the scale 0.01 to 1, and the path 1 m
            to 1000 km times the scale long.

    """

    def __new__(cls, path: Path, *, window: int = 25, scale: float = 1.0) -> RoadBelief: ...
    @property
    def scale(self) -> float:
        """Factor of all lengths of the belief."""
    @property
    def window(self) -> int:
        """Number of transitions from which a step estimates the friction, 1 to 1000.

        It has to be `history` of the controller whose steps are used. Setting a different number
        forgets where the vehicle was.

        Raises:
            InvalidArgumentError: unless it is set to a number from 1 to 1000.

        """
    @window.setter
    def window(self, window: int) -> None: ...
    def to_bytes(self) -> bytes:
        """Return the evidence of all cells, to be stored; equal beliefs give equal bytes."""
    def recall(self, data: bytes, age: float = 0.0) -> None:
        """Add the evidence of a belief about the same road that `to_bytes` returned `age` s ago.

        Its information falls to 1/e in 30 minutes, because the friction of a road changes.

        >>> from egp_service import Path, RoadBelief
        >>> path = Path.rounded_rectangle()
        >>> RoadBelief(path).recall(RoadBelief(path).to_bytes())

        Raises:
            InvalidArgumentError: if the age is negative or not finite; the belief is then
                unchanged.
            EgpError: if the data are no stored belief, are damaged, or are about another road; the
                belief is then unchanged.

        """
    def update(self, s: float, log_likelihood: ArrayLike | None = None) -> None:
        """Open a control period at arc length `s`, m, with what the last step found.

        `log_likelihood` (17,) is that of its `Friction`, the logarithms of the likelihoods of the
        coefficients `egp_service._core.FRICTION_HYPOTHESES`; without it nothing is added. Only
        ratios of likelihoods count.

        Raises:
            InvalidArgumentError: unless `s` is within ±1e9 m and the logarithms are from -1e6 to 0.

        """
    def leave(self) -> None:
        """Forget where the vehicle was: after it was moved, or when the history started anew."""
    def ahead(self, places: ArrayLike, risk: float) -> NDArray[np.float64]:
        """Return the friction to plan for (n,) at equidistant arc lengths `places` (n,), m.

        It is the friction below which that of each place lies with the probability `risk`, where
        each place may be on a patch.

        Raises:
            InvalidArgumentError: unless the places are within ±1e9 m, they increase with equal
                distances and cover at most 10 km, and `risk` is between 0 and 1.

        """
    def preview(self, places: ArrayLike) -> NDArray[np.float64]:
        """Return the `road_friction` (n + 1, 2) of a control step with stages at `places` (n,), m.

        Rows are the median and the standard deviation of the friction: first the mean over the
        places that the vehicle passed in the window, then at each of `places`, which do not
        decrease.

        Raises:
            InvalidArgumentError: unless there are at least two places, which do not decrease and
                are within ±1e9 m, and the road from the oldest place of the window to the last one
                is at most 10 km long.

        """
    def quantiles(self, s: ArrayLike, share: float) -> NDArray[np.float64]:
        """Return the quantiles (n,) of the friction at arc lengths `s` (n,), m.

        With the probability `share` the friction lies below its quantile.

        >>> import numpy as np
        >>> from egp_service import Path, RoadBelief
        >>> road = RoadBelief(Path.rounded_rectangle())
        >>> road.quantiles(np.array([10.0]), 0.5).round(2).tolist()  # nothing is known
        [0.7]

        Raises:
            InvalidArgumentError: unless the arc lengths are within ±1e9 m and `share` is between 0
                and 1.

        """
    def tile(self, index: int) -> bytes:
        """Return what this vehicle measured in 64 cells, without what was reported to it.

        A tile has 3136 bytes (docs/map.md).

        Raises:
            InvalidArgumentError: unless `index` is below `tiles`.

        """
    def report(self, index: int, tile: bytes) -> None:
        """Use what other vehicles reported about a tile, in place of earlier reports about it.

        Reports are never part of `tile` or `to_bytes`.

        Raises:
            InvalidArgumentError: if there is no such tile.
            EgpError: if the bytes are not those of a tile.

        """
    @property
    def tiles(self) -> int:
        """Number of tiles of the road."""
    @property
    def trust(self) -> float | None:
        """Probability that the reports describe the road, from what the vehicle measured itself.

        None without reports. Plans weigh the reports by it.
        """

def merge_tiles(
    contributions: Sequence[tuple[bytes, float]],
    *,
    capacity: float | None = None,
    lifetime: float | None = None,
) -> bytes:
    """Merge what several vehicles measured in the same tile, each with its age in s.

    Each contributes at most `capacity` nats (default 6) to a cell, and its information falls to 1/e
    in `lifetime` s (default 1800). Of n informative contributions to a cell, of at least 0.5 nats,
    the (n - 1) // 2 smallest likelihoods of a coefficient do not count (a trimmed sum; docs/map.md,
    section 2). The result does not depend on the order.

    >>> from egp_service import Path, RoadBelief
    >>> from egp_service._core import merge_tiles
    >>> empty = RoadBelief(Path.rounded_rectangle()).tile(0)
    >>> merge_tiles([(empty, 0.0), (empty, 60.0)]) == empty
    True

    Raises:
        InvalidArgumentError: for an age that is negative or not finite, and for a setting that is
            not positive.
        EgpError: if bytes are not those of a tile.

    """

@final
class SpeedPlanner:
    """Plans the speed over the next 250 m of a path, once in each control period.

    If the smallest radius r of the path is less than 8 m, it is 31 r.

    `grip`, `v_max`, `end_speed` (m/s) and `tyres` are those of `SpeedProfile`. The path's zones of
    friction are not used. Without `end_speed` a plan takes no account of the end of an open path,
    behind which it goes straight on: for a vehicle that shall stop there, state 0.

    >>> import numpy as np
    >>> from egp_service import Path, SpeedPlanner, VehicleParameters
    >>> points = np.column_stack([np.linspace(0.0, 120.0, 25), np.zeros(25)])
    >>> path = Path.from_points(points, closed=False)
    >>> planner = SpeedPlanner(path, VehicleParameters.commonroad(1), end_speed=0.0)
    >>> friction = np.full(len(planner.places(0.0)), 0.8)
    >>> planner.plan(0.0, friction, 10.0).speed(np.array([0.0, 120.0])).round(2).tolist()
    [10.07, 0.0]

    Raises:
        InvalidArgumentError: if a number is out of range, if a closed path has an `end_speed`, and
            if the path is shorter than 1 m.

    """

    def __new__(
        cls,
        path: Path,
        vehicle: VehicleParameters,
        grip: float = 0.8,
        v_max: float = 30.0,
        *,
        end_speed: float | None = None,
        tyres: ArrayLike | None = None,
    ) -> SpeedPlanner: ...
    def places(self, s: float) -> NDArray[np.float64]:
        """Return the arc lengths (n,), m, at which `plan` needs the friction; `s` is in m.

        Raises:
            InvalidArgumentError: unless `s` is finite.

        """
    def plan(self, s: float, friction: ArrayLike, v: float | None = None) -> SpeedProfile:
        """Plan the fastest speed from `s` on for the friction coefficients (n,) at the `places`.

        The plan has the present speed `v`, m/s, at half the spacing of its places behind `s`, m.
        Without a speed it begins with the largest one. Where the vehicle is too fast for what lies
        ahead, the plan brakes with all grip.

        Raises:
            InvalidArgumentError: unless `s` is finite, `v` is within ±10000 m/s, and there is a
                positive coefficient for each of the places.

        """
