"""The publication of a simulated vehicle's state for `egp monitor`."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from egp_service.cli.options import fleet_and_name
from egp_service.cli.output import say
from egp_service.control.endpoints import MONITOR_PORT, check_endpoints, why_unreachable
from egp_service.control.status import StatusPublisher
from egp_service.simulation.recording import plant_truth
from egp_service.simulation.scene import vehicle_road

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rich.console import Console

    from egp_service.control.step import StepController
    from egp_service.simulation.scenario import Scenario
    from egp_service.simulation.trace import Period


@contextmanager
def publication(
    scenario: Scenario,
    controller: StepController,
    endpoint: str | None,
    *,
    vehicle: str | None,
    zenoh_file: Path | None,
    console: Console,
) -> Iterator[Callable[[Period], None]]:
    """Give what to call with each period; without an endpoint it does nothing.

    Says if no program listens at the endpoint. A monitor that is started later shows the rest.
    `vehicle` is a name as for `fleet_and_name`.
    """
    if endpoint is None:
        yield lambda _: None
        return
    check_endpoints([endpoint], MONITOR_PORT)
    if reason := why_unreachable(endpoint):
        say(
            console,
            f"No program listens at {endpoint} ({reason}), so that no page shows this drive; start "
            f"`egp monitor --listen {endpoint}`",
        )
    road = vehicle_road(scenario)
    fleet, name = fleet_and_name(vehicle)
    with StatusPublisher(
        controller, endpoint, fleet=fleet, vehicle=name, road=road, zenoh_file=zenoh_file
    ) as status:

        def publish(period: Period) -> None:
            truth = period.truth
            status.add(
                period.step,
                period.measured,
                truth.time,
                lateral_error=truth.lateral_error,
                truth=plant_truth(period),
            )

        yield publish
