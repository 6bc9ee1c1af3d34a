"""Controllers that ask a service: a running one, or one that is started for the purpose."""

from __future__ import annotations

import tomllib
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from egp_service._core import Engine, Library
from egp_service.cli.options import fleet_and_name
from egp_service.cli.waiting import waiting
from egp_service.control.client import VehicleClient
from egp_service.control.service_process import ServiceProcess
from egp_service.control.toml_text import dumps
from egp_service.simulation.scenario import gate_settings, library_path

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from egp_service.control.step import StepController
    from egp_service.simulation.scenario import Scenario

CONNECT_SECONDS: Final = 10.0
"""Time in which a running service must answer."""


def connected(
    endpoint: str | None,
    gate: Mapping[str, float],
    vehicle: str | None,
    *,
    zenoh_file: Path | None,
    key_file: Path | None,
    traces: Path | None = None,
) -> VehicleClient:
    """Connect to a running service at an endpoint, or at those of `zenoh_file`.

    `vehicle` is a name as for `fleet_and_name`, and the rest is as for `VehicleClient.connect`.
    """
    fleet, name = fleet_and_name(vehicle)
    endpoints = [] if endpoint is None else [endpoint]
    with waiting("a service", endpoints, CONNECT_SECONDS):
        return VehicleClient.connect(
            endpoints,
            fleet=fleet,
            vehicle=name,
            gate=gate,
            timeout=CONNECT_SECONDS,
            zenoh_file=zenoh_file,
            key_file=key_file,
            traces=traces,
        )


def remote_controller(
    scenario: Scenario,
    endpoint: str | None,
    vehicle: str | None = None,
    *,
    zenoh_file: Path | None = None,
    key_file: Path | None = None,
    traces: Path | None = None,
) -> VehicleClient:
    """Ask a running service, which uses its own library and settings instead of the scenario's.

    The controller has `library_file` and `frictions` of the scenario's library if the service has
    the same one. The arguments are as for `connected`.
    """
    file = library_path(scenario).absolute()
    own = Library.load(file)
    gate = gate_settings(scenario)
    client = connected(
        endpoint, gate, vehicle, zenoh_file=zenoh_file, key_file=key_file, traces=traces
    )
    if own.id == client.library.hex():
        client.library_file = file
        client.frictions = [member.friction for member in own.members]
    return client


@contextmanager
def service_controller(scenario: Scenario) -> Iterator[StepController]:
    """Ask a service that is started for this purpose in its own process."""
    library = library_path(scenario)
    # Errors of library and settings are told here, before a process gets both in a temporary file.
    engine = Engine(str(library), dumps(scenario.control))
    with (
        ServiceProcess(library, scenario.control) as service,
        VehicleClient.connect([service.endpoint], gate=gate_settings(scenario)) as client,
    ):
        client.settings = tomllib.loads(engine.settings_toml)
        client.stated_settings = scenario.control
        client.library_file = library.absolute()
        client.frictions = engine.frictions
        yield client
