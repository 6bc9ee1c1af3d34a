"""The demo: laps of unknown friction, and laps that are told it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from egp_service._core import Library, write_library_subset
from egp_service.cli.backends import service_controller
from egp_service.simulation.reference import load_belief
from egp_service.simulation.runs import record_run
from egp_service.simulation.scenario import library_path, load_scenario, told_zones

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from egp_service.simulation.closed_loop import Run
    from egp_service.simulation.scenario import Scenario
    from egp_service.simulation.trace import Period

SCENARIO = "rounded-rectangle"
LAPS = ("first lap", "second lap", "third lap")
TOLD = "told"


@dataclass(frozen=True, slots=True)
class Lap:
    """A lap of the demo."""

    label: str
    run: Run
    folder: Path
    alone: bool = False
    """Whether one member drove it, and not the ensemble."""


def drive_laps(
    library: Path | None, folder: Path, observe: Callable[[str, Period], None]
) -> list[Lap]:
    """Drive three laps on which the friction is found, and laps that are told all zones.

    The first three laps remember what the control steps found. Then the same lap is driven with a
    reference speed that is told all zones: with the ensemble, and with each member alone, whose
    library contains the same bits of its GPs. `library` is the shipped one by default. Each lap has
    its own folder in `folder`.
    """
    scenario = load_scenario(SCENARIO)
    source = library_path(scenario) if library is None else library
    scenario = replace(scenario, library=str(source))
    laps = list(_laps_of_unknown_friction(scenario, folder, observe))
    told = told_zones(scenario)
    laps.append(_lap(TOLD, told, folder / "told", observe))
    for number, member in enumerate(Library.load(source).members):
        place = folder / f"member-{number + 1}"
        place.mkdir(parents=True)
        path = place / "library.safetensors"
        write_library_subset(source, path, [number])
        label = f"told, μ {member.friction:g}"
        lap = _lap(label, replace(told, library=str(path)), place, observe)
        laps.append(replace(lap, alone=True))
    return laps


def _laps_of_unknown_friction(
    scenario: Scenario, folder: Path, observe: Callable[[str, Period], None]
) -> Iterator[Lap]:
    """Drive the same lap again and again with what the laps before found."""
    belief = load_belief(scenario, None)
    with service_controller(scenario) as controller:
        for number, label in enumerate(LAPS):
            place = folder / f"lap-{number + 1}"
            run = record_run(scenario, controller, place, partial(observe, label), belief)
            yield Lap(label, run, place)
            controller.reset()
            belief.leave()


def _lap(
    label: str, scenario: Scenario, folder: Path, observe: Callable[[str, Period], None]
) -> Lap:
    with service_controller(scenario) as controller:
        return Lap(label, record_run(scenario, controller, folder, partial(observe, label)), folder)
