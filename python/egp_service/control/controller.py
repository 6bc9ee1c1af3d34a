"""The control step in this process. Requests and replies have the same bytes as with a service."""

from __future__ import annotations

import time
import tomllib
from typing import TYPE_CHECKING

from egp_service._core import Engine, InProcessDriver
from egp_service.control.step import Step, StepController, rows
from egp_service.control.toml_text import dumps

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import ArrayLike


class Controller(StepController):
    """Compute the steps in this process with a library file; `docs/python.md` shows a lap."""

    def __init__(
        self,
        library: str | Path,
        settings: str | Mapping[str, object] = "",
        *,
        gate: Mapping[str, float],
        want_sigma: bool = False,
    ) -> None:
        """Load and verify a library; `settings` override the control step's defaults.

        They are a mapping such as `{"cost": {"lateral": 30.0}}` or the same as TOML text.

        `gate` holds the limits of the driven vehicle, as `VehicleParameters.gate_limits` gives
        them, and may hold `max_tail_ticks` and `stop_deceleration`.

        Raises `EgpError` for a library, settings or gate settings that cannot be used, and for a
        gate that allows more than the vehicle that the library was trained for can do.
        """
        text = settings if isinstance(settings, str) else dumps(settings)
        engine = Engine(str(library), text)
        self.library, self.members = engine.library_id, engine.members
        self.dt, self.horizon = engine.dt, engine.horizon
        self.settings: Mapping[str, object] = tomllib.loads(engine.settings_toml)
        """Every setting that the control step uses, those of the library's period included."""
        self._driver = InProcessDriver(engine, gate=gate, want_sigma=want_sigma)

    def step(
        self,
        x: ArrayLike,
        reference: ArrayLike,
        widths: ArrayLike | None = None,
        *,
        deadline: float | None = None,
    ) -> Step:
        """Return the step; see `StepController.step`. `deadline` is only stated in the request."""
        start = time.perf_counter()
        budget = self._driver.budget if deadline is None else deadline
        edges = None if widths is None else rows(widths)
        decision = self._driver.step(budget, rows(x), rows(reference), edges)
        return Step.of(decision, self._driver.weights, time.perf_counter() - start)

    def reset(self) -> None:
        """Leave STOP and forget the past."""
        self._driver.reset()
