"""The source of simulators that a test writes to a module of its own: cars without slip."""

from __future__ import annotations


def rails_car(name: str, mass: float, wheelbase: float) -> str:
    """Return the source of a class of a car with this mass, kg, and distance of the axles, m."""
    return f"""
import math

class {name}:
    made = 0

    def __init__(self):
        type(self).made += 1

    def reset(self, x):
        self.state = [*x[:4], 0.0, x[5], x[6]]

    def step(self, u, dt, friction):
        p_x, p_y, v, yaw, _, _, delta = self.state
        v, delta = v + u[0] / {mass} * dt, delta + u[1] * dt
        omega = v * math.tan(delta) / {wheelbase}
        yaw += omega * dt
        self.state = [p_x + v * math.cos(yaw) * dt, p_y + v * math.sin(yaw) * dt, v, yaw, 0.0,
                      omega, delta]
"""
