"""The control step in this process. Requests and replies have the same bytes as with a service."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from egp_service._core import (
    EgpError,
    Engine,
    InProcessDriver,
    InvalidArgumentError,
    check_settings,
)
from egp_service.control.step import StepController, as_dict
from egp_service.control.toml_text import dumps
from egp_service.optimal_control import OcpProblem

if TYPE_CHECKING:
    from egp_service._core import Decision
    from egp_service.control.step import Measured


# How an error of TOML begins, before the lines that show the place, and what is wrong in the last.
_PLACE: Final = re.compile(r"TOML parse error at line (\d+), .*\n(.+)", re.DOTALL)
_UNKNOWN: Final = re.compile(r"unknown field `.*`, expected (?:one of )?")


class Controller(StepController):
    """Compute the steps in this process with a library file; `docs/python.md` shows a drive."""

    settings: Mapping[str, object]
    _driver: InProcessDriver

    def __init__(
        self,
        library: str | os.PathLike[str],
        settings: str | Mapping[str, object] = "",
        *,
        gate: Mapping[str, float],
        want_sigma: bool = False,
    ) -> None:
        """Load and verify a library; `settings` override the control step's defaults.

        They are a mapping such as `{"cost": {"lateral": 30.0}}` or the same as TOML text.

        `gate` holds the limits of the driven vehicle in SI units and rad, as
        `VehicleParameters.gate_limits` gives them, and may hold `max_tail_ticks` and
        `stop_deceleration`. With `want_sigma` steps have the standard deviations `sigma`.

        Raises:
            InvalidArgumentError: for a library that is no path, and for settings of which a name or
                a type is wrong.
            EgpError: for a library, settings or gate settings that cannot be used, and for a gate
                that allows more than the vehicle that the library was trained for can do.

        """
        super().__init__()
        if not isinstance(library, str | os.PathLike):
            raise InvalidArgumentError(
                "library: expected the path of a library file, as text or as pathlib.Path, got an "
                f"object of the type {type(library).__name__}"
            )
        text = _text(settings)
        library = os.fspath(library)
        engine = Engine(library, text)
        self.library, self.members = engine.library_id, engine.members
        self.frictions = engine.frictions
        self.dt, self.horizon, self.history = engine.dt, engine.horizon, engine.history
        self.settings = _read_only(tomllib.loads(engine.settings_toml))
        self.stated_settings = _read_only(tomllib.loads(text))
        self.library_file = Path(library).absolute()
        self._engine = engine
        self._driver = InProcessDriver(engine, gate=as_dict(gate), want_sigma=want_sigma)

    def problem(self, request: bytes) -> OcpProblem:
        """Return the optimal control problem that the step of a request solves.

        `request` is that of a `Step` or of a recorded step, with the library and the settings of
        this controller. The problem is that of the step's last linearisation.

        >>> import numpy as np
        >>> from egp_service import Controller, Plant, shipped
        >>> from egp_service.optimal_control import solve_ocp
        >>> limits = Plant().parameters.gate_limits()
        >>> with Controller(shipped.DEMO_LIBRARY, gate=limits) as controller:
        ...     s = 0.3 * np.arange(controller.horizon + 1)
        ...     reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
        ...     step = controller.step([0.0, 0.2, 15.0, 0.0, 0.0, 0.0, 0.0], reference)
        ...     problem = controller.problem(step.request)
        >>> result = solve_ocp(*problem)
        >>> result.status, result.u.shape
        ('solved', (40, 2))
        >>> mass = Plant().parameters.mass
        >>> bool(np.allclose(result.u * [mass, 1.0], step.plan_u, atol=1e-4))
        True

        Raises:
            RefusedError: for bytes that are no request of this library.

        """
        return OcpProblem(*self._engine.problem(request))

    def _decide(self, start: float, budget: float, measured: Measured) -> Decision:
        del start  # the driver needs no time, because the engine is in this process
        return self._driver.step(budget, *measured)


def _read_only(settings: Mapping[str, object]) -> Mapping[str, object]:
    """Return settings whose tables and lists cannot be changed; lists become tuples."""
    return MappingProxyType({name: _fixed(value) for name, value in settings.items()})


def _fixed(value: object) -> object:
    if isinstance(value, Mapping):
        return _read_only(value)
    return tuple(value) if isinstance(value, list) else value


def _text(settings: str | Mapping[str, object] | Path) -> str:
    """Return the settings as TOML."""
    if isinstance(settings, Mapping):
        return settings_text(settings, "settings")
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


def settings_text(settings: Mapping[str, object], where: str) -> str:
    """Return a mapping of settings as TOML.

    Raises:
        InvalidArgumentError: if a name or a type is wrong; `where` is the name of the mapping.
        EgpError: for a value outside its range, and for one without a form in TOML.

    """
    text = dumps(settings)
    if dotted := [key for key in settings if "." in key]:
        *tables, name = dotted[0].split(".")
        nested: object = {name: settings[dotted[0]]}
        for table in reversed(tables):
            nested = {table: nested}
        raise InvalidArgumentError(
            f"{where}: unknown name {dotted[0]!r}; nest it, as in {nested!r}"
        )
    try:
        check_settings(text)
    except EgpError as error:
        if (found := _PLACE.search(str(error).strip())) is None:
            raise
        name = ".".join((where, *_name(text, int(found[1]))))
        told = _UNKNOWN.sub("unknown; known: ", found[2].splitlines()[-1])
        raise InvalidArgumentError(f"{name}: {told}") from error
    return text


def _name(text: str, number: int) -> list[str]:
    """Return the keys that lead to what stands in a line of a text that `dumps` wrote."""
    lines = text.splitlines()[:number]
    key = [] if lines[-1].startswith("[") else [lines[-1].partition(" = ")[0]]
    headers = [line.strip("[]") for line in lines if line.startswith("[")]
    return [*headers[-1:], *key]


def _is_path(text: str) -> bool:
    """Tell the path of a file from TOML text, which has an equals sign or several lines."""
    text = text.strip()
    return text.endswith(".toml") and "=" not in text and "\n" not in text
