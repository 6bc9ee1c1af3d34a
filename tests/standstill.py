"""A vehicle that always measures the same state."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from egp_service.control.step import Step, StepController


class Standstill:
    """Steps of a vehicle that always measures the same state on a straight road."""

    def __init__(self, controller: StepController, deadline: float | None = None) -> None:
        """Use this controller, with this deadline unless a step states another one."""
        self.controller, self.deadline = controller, deadline
        s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
        zero = np.zeros_like(s)
        self.reference = np.column_stack([s, zero, zero + 15.0, zero])

    def step(self, deadline: float | None = None) -> Step:
        """Take the next step."""
        x = np.array([0.0, 0.3, 15.0, 0.0, 0.0, 0.0, 0.0])
        deadline = self.deadline if deadline is None else deadline
        return self.controller.step(x, self.reference, deadline=deadline)
