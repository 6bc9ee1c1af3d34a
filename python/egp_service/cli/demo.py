"""The demo: a lap over three surfaces with the ensemble, and with each single member."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from egp_service._core import Library, write_library_subset
from egp_service.cli.backends import service_controller
from egp_service.simulation.runs import record_run
from egp_service.simulation.scenario import library_path, load_scenario

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from egp_service.simulation.closed_loop import Run
    from egp_service.simulation.trace import Period

SCENARIO = "rounded-rectangle"


@dataclass(frozen=True, slots=True)
class Lap:
    """A lap of the demo."""

    label: str
    run: Run
    folder: Path


def drive_laps(
    library: Path | None, folder: Path, observe: Callable[[str, Period], None]
) -> list[Lap]:
    """Drive a lap with the ensemble and one with each single member, each with its own service.

    The library of a single member contains the same bits of its GPs; everything else is equal.
    `library` is the shipped one by default. Each lap has its own folder in `folder`.
    """
    scenario = load_scenario(SCENARIO)
    source = library_path(scenario) if library is None else library
    members = Library.load(source).members
    laps = []
    for number in range(len(members) + 1):
        place = folder / ("ensemble" if number == 0 else f"member-{number}")
        label, path = "ensemble", source
        if number > 0:
            label = f"only μ {members[number - 1].friction:g}"
            path = place / "library.safetensors"
            place.mkdir(parents=True)
            write_library_subset(source, path, [number - 1])
        chosen = replace(scenario, library=str(path))
        with service_controller(chosen) as controller:
            run = record_run(chosen, controller, place, partial(observe, label))
        laps.append(Lap(label, run, place))
    return laps
