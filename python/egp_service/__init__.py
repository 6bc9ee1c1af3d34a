"""Ensemble Gaussian-process model predictive control for roads of unknown friction."""
