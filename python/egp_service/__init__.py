"""Ensemble Gaussian-process model predictive control for roads of unknown friction."""

from egp_service._core import (
    EgpError,
    Library,
    Path,
    Plant,
    SpeedProfile,
    VehicleParameters,
    horizon_reference,
)
from egp_service.client import VehicleClient
from egp_service.controller import Controller
from egp_service.stepper import Step

__all__ = [
    "Controller",
    "EgpError",
    "Library",
    "Path",
    "Plant",
    "SpeedProfile",
    "Step",
    "VehicleClient",
    "VehicleParameters",
    "horizon_reference",
]
