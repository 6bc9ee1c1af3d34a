"""A scenario's control steps computed in this process."""

from __future__ import annotations

from typing import TYPE_CHECKING

from egp_service.control.controller import Controller
from egp_service.simulation.scenario import gate_settings, library_path

if TYPE_CHECKING:
    from egp_service.simulation.scenario import Scenario


def in_process_controller(scenario: Scenario) -> Controller:
    """Return a controller with library, settings and gate of the scenario.

    Raises:
        EgpError: as `Controller`, if library, settings or gate cannot be used.

    """
    return Controller(library_path(scenario), scenario.control, gate=gate_settings(scenario))
