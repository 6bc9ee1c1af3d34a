"""Ensemble Gaussian-process model predictive control for roads of unknown friction.

The public names are imported when they are first used, so that importing one subpackage
(`control`, `simulation`, `data`, `training`, `evaluation`, `cli`) does not import the libraries
that only another subpackage needs.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Final

from egp_service._core import (
    EgpError,
    Friction,
    InvalidArgumentError,
    Library,
    LibraryError,
    Path,
    Plant,
    RefusedError,
    RoadBelief,
    SpeedPlanner,
    SpeedProfile,
    VehicleLostError,
    VehicleParameters,
    horizon_reference,
)
from egp_service.zenoh_threads import use_default

use_default()

if TYPE_CHECKING:
    import os

    from egp_service.control.client import VehicleClient
    from egp_service.control.controller import Controller
    from egp_service.control.fleet_map import FleetMap
    from egp_service.control.network import ServiceUnreachableError
    from egp_service.control.recorder import Recorder
    from egp_service.control.status import StatusPublisher
    from egp_service.control.step import Step

    __version__: str
    """The version of the package."""

    # Not an import: below, modules of lower layers import this package.
    def read_vehicle(path: str | os.PathLike[str]) -> VehicleParameters:
        """Read a vehicle's parameters from a TOML file; see `egp_service.vehicle`."""
else:
    _MODULES: Final = {
        "Controller": "egp_service.control.controller",
        "FleetMap": "egp_service.control.fleet_map",
        "Recorder": "egp_service.control.recorder",
        "ServiceUnreachableError": "egp_service.control.network",
        "StatusPublisher": "egp_service.control.status",
        "Step": "egp_service.control.step",
        "VehicleClient": "egp_service.control.client",
        "read_vehicle": "egp_service.vehicle",
    }

    def __getattr__(name: str) -> object:
        """Import a public name from its module when it is first used (PEP 562)."""
        if name == "shipped":
            return import_module("egp_service.shipped")
        if name == "__version__":
            return import_module("importlib.metadata").version("egp-service")
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)

    def __dir__() -> list[str]:
        return sorted({*globals(), *_MODULES, "__version__", "shipped"})


__all__ = [
    "Controller",
    "EgpError",
    "FleetMap",
    "Friction",
    "InvalidArgumentError",
    "Library",
    "LibraryError",
    "Path",
    "Plant",
    "Recorder",
    "RefusedError",
    "RoadBelief",
    "ServiceUnreachableError",
    "SpeedPlanner",
    "SpeedProfile",
    "StatusPublisher",
    "Step",
    "VehicleClient",
    "VehicleLostError",
    "VehicleParameters",
    "horizon_reference",
    "read_vehicle",
]
