"""Where control steps are computed: here, in a service of our own, or in a running one."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from egp_service.client import VehicleClient
from egp_service.controller import Controller
from egp_service.scenario import gate_settings, library_path
from egp_service.service_process import ServiceProcess
from egp_service.toml_text import dumps

if TYPE_CHECKING:
    from collections.abc import Iterator

    from egp_service.scenario import Scenario
    from egp_service.stepper import Stepper


def in_process_stepper(scenario: Scenario) -> Controller:
    """Compute the steps in this process."""
    return Controller(library_path(scenario), dumps(scenario.control), gate=gate_settings(scenario))


def remote_stepper(scenario: Scenario, endpoint: str) -> VehicleClient:
    """Ask a running service; its library and settings count, not the scenario's."""
    return VehicleClient.connect([endpoint], gate=gate_settings(scenario))


@contextmanager
def service_stepper(scenario: Scenario) -> Iterator[Stepper]:
    """Ask a service started for this purpose in its own process."""
    with (
        ServiceProcess(library_path(scenario), scenario.control) as service,
        VehicleClient.connect([service.endpoint], gate=gate_settings(scenario)) as client,
    ):
        yield client
