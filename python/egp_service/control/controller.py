"""The control step in this process. Requests and replies have the same bytes as with a service."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from egp_service._core import Engine, InProcessDriver, InvalidArgumentError
from egp_service.control.step import StepController
from egp_service.control.toml_text import dumps

if TYPE_CHECKING:
    from egp_service._core import Decision
    from egp_service.control.step import Measured


class Controller(StepController):
    """Compute the steps in this process with a library file; `docs/python.md` shows a lap."""

    settings: Mapping[str, object]
    _driver: InProcessDriver

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

        Raises:
            EgpError: for a library, settings or gate settings that cannot be used, and for a gate
                that allows more than the vehicle that the library was trained for can do.

        """
        super().__init__()
        text = _text(settings)
        engine = Engine(str(library), text)
        self.library, self.members = engine.library_id, engine.members
        self.frictions = engine.frictions
        self.dt, self.horizon, self.history = engine.dt, engine.horizon, engine.history
        self.settings = tomllib.loads(engine.settings_toml)
        self.stated_settings = tomllib.loads(text)
        self.library_file = Path(library).absolute()
        self._driver = InProcessDriver(engine, gate=gate, want_sigma=want_sigma)

    def _decide(self, start: float, budget: float, measured: Measured) -> Decision:
        del start  # the driver needs no time, because nobody else can be asked
        return self._driver.step(budget, *measured)


def _text(settings: str | Mapping[str, object] | Path) -> str:
    """Return the settings as TOML."""
    if isinstance(settings, Mapping):
        return dumps(settings)
    if isinstance(settings, Path) or _is_path(str(settings)):
        raise InvalidArgumentError(
            f"settings: expected TOML text or a mapping, got the path {str(settings)!r}; "
            f"use pathlib.Path({str(settings)!r}).read_text()"
        )
    if not isinstance(settings, str):
        raise InvalidArgumentError(
            f"settings: expected TOML text or a mapping, got {settings!r}; leave them out for the "
            "defaults"
        )
    return settings


def _is_path(text: str) -> bool:
    """Tell the path of a file from TOML text, which has an equals sign or several lines."""
    text = text.strip()
    return text.endswith(".toml") and "=" not in text and "\n" not in text
