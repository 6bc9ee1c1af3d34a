"""Ensemble Gaussian-process model predictive control for roads of unknown friction."""

from egp_service._core import EgpError

__all__ = ["EgpError"]
