"""The course of a scenario: its path with friction zones, and the reference speed along it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from egp_service._core import Path, SpeedProfile
from egp_service.scenario import Scenario, ScenarioError

if TYPE_CHECKING:
    from collections.abc import Callable

TRACKS: dict[str, Callable[..., Path]] = {
    "rounded-rectangle": Path.rounded_rectangle,
    "l-shape": Path.l_shape,
    "lane-change": Path.lane_changes,
    "iso-3888-2": Path.iso_3888_2,
    "random": Path.random,
    "csv": Path.from_csv,
}


def build_path(scenario: Scenario) -> Path:
    """Path of the scenario's track, with widths and friction zones.

    Raises `ScenarioError` for an unknown track or measure, `EgpError` for measures that don't fit.
    """
    track = scenario.track
    if track.kind not in TRACKS:
        raise ScenarioError(f"no track {track.kind!r}; known: {', '.join(TRACKS)}")
    parameters: dict[str, object] = dict(track.parameters)
    if track.kind == "csv":
        if track.file is None:
            raise ScenarioError("track kind csv needs the field `file`")
        parameters["file"] = track.file
    if track.kind == "random":
        parameters["seed"] = scenario.seed
    try:
        path = TRACKS[track.kind](**parameters)
    except TypeError as error:
        raise ScenarioError(f"track {track.kind}: {error}") from error
    return path.with_friction([(zone.start, zone.friction) for zone in scenario.zones])


def build_profile(scenario: Scenario, path: Path) -> SpeedProfile:
    """Plan the reference speed: `speed.grip` of what each zone holds, at most `speed.v_max`."""
    return SpeedProfile(path, scenario.speed.grip, scenario.speed.v_max)
