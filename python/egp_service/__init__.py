"""Ensemble Gaussian-process model predictive control for roads of unknown friction."""

from egp_service._core import EgpError, Library, Path, Plant, SpeedProfile, horizon_reference
from egp_service.control.client import VehicleClient
from egp_service.control.controller import Controller
from egp_service.control.stepper import Step

__all__ = [
    "Controller",
    "EgpError",
    "Library",
    "Path",
    "Plant",
    "SpeedProfile",
    "Step",
    "VehicleClient",
    "horizon_reference",
]
