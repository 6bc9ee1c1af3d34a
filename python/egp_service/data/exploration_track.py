"""Tracks for data collection: start states, reference ahead and distance from the track."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from egp_service._core import EgpError, Path, SpeedProfile, horizon_reference
from egp_service.data.experiment import WHEELBASE

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from egp_service._core import VehicleParameters

# Functions of a seed, which only the random track uses.
TRACKS: Final[dict[str, Callable[[int], Path]]] = {
    "rounded-rectangle": lambda _: Path.rounded_rectangle(),
    "l-shape": lambda _: Path.l_shape(),
    "random": Path.random,
}
# m from the path; beyond all track edges, so that slides beyond the edge are recorded.
_LEAVE: Final = 6.0
_PREVIEW: Final = 0.6  # s of reference for the driver
_GRIP_STEP: Final = 0.05  # speed profiles exist for its multiples


def check_track(name: str) -> None:
    """Errors if there is no track of this name."""
    if name not in TRACKS:
        raise EgpError(f"no track '{name}' to collect on: expected one of {', '.join(TRACKS)}")


class ExplorationTrack:
    """A closed track with speed profiles for the requested frictions and grips."""

    def __init__(
        self,
        name: str,
        vehicle: VehicleParameters,
        seed: int = 0,
        *,
        reverse: bool = False,
        wheelbase: float = WHEELBASE,
    ) -> None:
        """Build a track of `TRACKS`; `reverse` reverses its direction, so that it turns right.

        The speed profiles are those of `vehicle`, and `wheelbase` (m) gives the steering angle at
        the start.
        """
        path = TRACKS[name](seed)
        self._path = _reversed(path) if reverse else path
        self._vehicle = vehicle
        self._wheelbase = wheelbase
        self._profiles: dict[tuple[float, int], SpeedProfile] = {}

    @property
    def length(self) -> float:
        """Length of a lap, m."""
        return self._path.length

    def start(self, s: float, friction: float, grip: float) -> NDArray[np.float64]:
        """Return the state `[p_x, p_y, v_x, psi, v_y, omega, delta]` on the profile at `s`."""
        at = np.array([s])
        x, y, yaw, curvature = (column[0] for column in self._path.sample(at)[:4])
        v = self._profile(friction, grip).speed(at)[0]
        return np.array([x, y, v, yaw, 0.0, v * curvature, math.atan(self._wheelbase * curvature)])

    def look(
        self, x: NDArray[np.float64], friction: float, grip: float, dt: float
    ) -> tuple[NDArray[np.float64], bool]:
        """Return reference rows `[p_x, p_y, v_x, psi]` ahead, and whether x is near the track."""
        profile = self._profile(friction, grip)
        preview = math.ceil(_PREVIEW / dt)
        reference, _, projection = horizon_reference(
            self._path, profile, x, dt, preview, catch_up=False
        )
        return reference, abs(projection.lateral) < _LEAVE

    def _profile(self, friction: float, grip: float) -> SpeedProfile:
        steps = max(1, round(grip / _GRIP_STEP))
        key = (friction, steps)
        if key not in self._profiles:
            # Profiles accept a grip of at most 1, so the friction is scaled instead.
            path = self._path.with_friction([(0.0, steps * _GRIP_STEP * friction)])
            self._profiles[key] = SpeedProfile(path, self._vehicle, 1.0)
        return self._profiles[key]


def _reversed(path: Path) -> Path:
    """Return the path in the opposite direction."""
    s = np.arange(0.0, path.length - 1.0, 2.0)
    x, y = path.sample(s)[:2]
    return Path.from_points(np.column_stack([x, y])[::-1].copy(), closed=True)
