"""A user's simulator on a surface that is the same everywhere, as data are collected."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from egp_service._core import Path, surface_friction
from egp_service.simulation.plant import OwnPlant

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class OneSurface(OwnPlant):
    """A user's simulator, checked, of which each step states the surface."""

    def __init__(self, name: str) -> None:
        """Load `module:Class`; see `load_simulator`."""
        super().__init__(name, _road(1.0))

    def step(self, u: NDArray[np.float64], dt: float, friction: float | str) -> None:
        """Drive one period on a friction coefficient, or on that of a preset.

        Raises:
            EgpError: as `OwnPlant.drive`.

        """
        self._path = _road(surface_friction(friction))
        self.drive(u, dt, 0.0)


@cache
def _road(friction: float) -> Path:
    return Path.rounded_rectangle().with_friction([(0.0, friction)])
