"""Steppers that compute in this process, in a service started here, or in a running service."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from egp_service.client import VehicleClient
from egp_service.controller import Controller
from egp_service.scenario import library_path
from egp_service.service_process import ServiceProcess
from egp_service.toml_text import dumps

if TYPE_CHECKING:
    from collections.abc import Iterator

    from egp_service.scenario import Scenario
    from egp_service.stepper import Stepper


def in_process_stepper(scenario: Scenario) -> Controller:
    """Return a stepper that computes in this process."""
    return Controller(library_path(scenario), dumps(scenario.control), gate=scenario.gate)


def remote_stepper(scenario: Scenario, endpoint: str) -> VehicleClient:
    """Return a stepper for a running service, which uses its own library and settings."""
    return VehicleClient.connect([endpoint], gate=scenario.gate)


@contextmanager
def service_stepper(scenario: Scenario) -> Iterator[Stepper]:
    """Start a service in its own process and yield a stepper for it."""
    with (
        ServiceProcess(library_path(scenario), scenario.control) as service,
        VehicleClient.connect([service.endpoint], gate=scenario.gate) as client,
    ):
        yield client
