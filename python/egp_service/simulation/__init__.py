"""Simulation: scenarios, the closed loop around a simulated vehicle, recordings and pictures."""
