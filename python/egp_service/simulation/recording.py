"""Recordings of simulated runs: the control steps, the plant's true state, and the road."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from egp_service.control.messages import message_class
from egp_service.control.recorder import SCENARIO, Recorder
from egp_service.quantities import STATE
from egp_service.simulation.scene import road_scene

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from google.protobuf.message import Message

    from egp_service.control.step import StepController
    from egp_service.simulation.scenario import Scenario
    from egp_service.simulation.trace import Period


@contextmanager
def recording(
    path: Path, scenario: Scenario, controller: StepController
) -> Iterator[Callable[[Period], None]]:
    """Record a run to `path`, which is readable at any time and complete at the end.

    Gives what to call with each period. Log times are seconds since the start of the run.
    """
    notes = {SCENARIO: {"name": scenario.name, "toml": scenario.toml()}}
    with Recorder(path, controller, notes=notes) as recorder:
        recorder.message("/scene", road_scene(scenario), 0.0)

        def add(period: Period) -> None:
            time = period.truth.time
            recorder.add(period.step, period.measured, time)
            recorder.message("/plant", plant_truth(period), time)

        yield add


def plant_truth(period: Period) -> Message:
    """Return the simulated truth of a control period as the message `PlantTruth`."""
    truth, step = period.truth, period.step
    return message_class("PlantTruth")(
        time=truth.time,
        **dict(zip(STATE, truth.x.tolist(), strict=True)),
        force=float(step.u[0]),
        steering_rate=float(step.u[1]),
        friction=truth.friction,
        path_s=truth.path_s,
        lateral_error=truth.lateral_error,
        heading_error=truth.heading_error,
        speed_reference=truth.speed_reference,
        mode=step.mode,
        weights=step.weights.tolist(),
        friction_planned=truth.friction_planned,
    )
