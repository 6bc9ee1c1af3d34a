"""Checks of the values of a scenario, whose errors name the field."""

from __future__ import annotations

import re
from dataclasses import asdict
from itertools import pairwise
from typing import TYPE_CHECKING

from egp_service._core import EgpError, surface_friction
from egp_service.control.controller import settings_text
from egp_service.simulation.configuration import ConfigurationError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from egp_service.simulation.scenario import Measurement, Scenario, Speed, Track

MAX_NAME = 50
# A run's folder has the name, so a name holds nothing that would lead to another folder.
_NAME = re.compile(rf"\w[\w .-]{{0,{MAX_NAME - 1}}}")
KNOWLEDGE = ("zones", "here", "weights", "nothing")
SPEEDS = (1e-3, 100.0)
"""The range of `speed.v_max`, m/s; the control step accepts no larger speed."""


class ScenarioError(ConfigurationError):
    """A scenario that does not exist or is invalid."""


def check_starts(starts: list[float], in_metres: bool, origin: str) -> None:  # noqa: FBT001
    """Raise `ScenarioError` unless zones that begin there cover the path from its start."""
    if not starts or starts[0] != 0.0:
        raise ScenarioError(f"{origin}: zones must begin with one at start = 0.0")
    if any(later <= earlier for earlier, later in pairwise(starts)):
        raise ScenarioError(f"{origin}: zones must be in order of start")
    if starts[-1] >= 1.0 and not in_metres:
        reason = f"must be below 1, a fraction of the path's length, got {starts[-1]}"
        last = f"{origin}: zones[{len(starts) - 1}].start {reason}"
        raise ScenarioError(f"{last}; for a start in m state zones_in_metres = true")


def check_name(name: str, origin: str) -> None:
    """Raise `ScenarioError` unless a folder can have the name."""
    if not _NAME.fullmatch(name):
        raise ScenarioError(
            f"{origin}: name must be 1 to {MAX_NAME} letters, digits, spaces and . _ -, with a "
            f"letter, digit or _ first, got {name!r}"
        )


def check_track(track: Track, origin: str) -> None:
    """Raise `ScenarioError` for what concerns a track from a file, if it is of another kind."""
    for name, value in (("file", track.file), ("closed", track.closed)):
        if value is not None and track.kind != "csv":
            raise ScenarioError(
                f"{origin}: track.{name} is for track kind 'csv', got kind {track.kind!r}: set "
                f"kind = 'csv', or leave out `{name}`"
            )


def check_measurement(measurement: Measurement, origin: str) -> None:
    """Raise `ScenarioError` for a negative standard deviation."""
    for name, deviation in asdict(measurement).items():
        if deviation < 0.0:
            raise ScenarioError(f"{origin}: measurement.{name} must be at least 0, got {deviation}")


def check_control(control: Mapping[str, object], origin: str) -> None:
    """Raise `ScenarioError` unless these are settings of the control step."""
    try:
        settings_text(control, "control")
    except EgpError as error:
        raise ScenarioError(f"{origin}: {error}") from error


def check_told(scenario: Scenario, origin: str) -> None:
    """Raise `ScenarioError` for a zone of which a simulator of one's own is told a part only."""
    for i, zone in enumerate(scenario.zones if scenario.plant is not None else ()):
        told = f"{scenario.plant} is told one friction coefficient"
        if len(zone.sides()) > 1:
            raise ScenarioError(
                f"{origin}: zones[{i}] has two sides, but {told}: leave out the right one"
            )
        if zone.surface is not None:
            raise ScenarioError(
                f"{origin}: zones[{i}].surface is a tyre's force over slip, but {told}: "
                f"state friction = {surface_friction(zone.surface):g} instead"
            )


def check_seed(seed: float, where: str) -> None:
    """Raise `ScenarioError` unless `seed` is a whole number from 0 to 2⁶³ - 1."""
    if not (0 <= seed < 1 << 63 and seed == int(seed)):
        raise ScenarioError(f"{where} must be a whole number from 0 to 2^63 - 1, got {seed}")


def check_speed(speed: Speed, origin: str) -> None:
    """Raise `ScenarioError` for a value outside its range, and for one without effect."""
    if not 0.0 < speed.grip <= 1.0:
        raise ScenarioError(f"{origin}: speed.grip must be above 0, at most 1, got {speed.grip}")
    if speed.knows not in KNOWLEDGE:
        raise ScenarioError(
            f"{origin}: speed.knows must be one of {', '.join(KNOWLEDGE)}, got {speed.knows!r}"
        )
    if not 0.0 < speed.risk < 1.0:
        raise ScenarioError(f"{origin}: speed.risk must be between 0 and 1, got {speed.risk}")
    least, most = SPEEDS
    if not least <= speed.v_max <= most:
        raise ScenarioError(
            f"{origin}: speed.v_max must be {least:g} to {most:g} m/s, got {speed.v_max:g}"
        )
    if speed.v_start is not None and not 0.0 <= speed.v_start <= most:
        raise ScenarioError(
            f"{origin}: speed.v_start must be 0 to {most:g} m/s, got {speed.v_start:g}"
        )
    if reason := why_unused(speed):
        _check_unused(speed, reason, origin)
    if speed.knows == "zones" and speed.friction is not None:
        raise ScenarioError(
            f"{origin}: speed.friction has no effect while speed.knows is 'zones'; set it to "
            "'nothing', 'here' or 'weights', or leave out `friction`"
        )


def _check_unused(speed: Speed, reason: str, origin: str) -> None:
    """Raise `ScenarioError` for a value without effect that is not the default.

    The text of a resolved scenario states the defaults as well.
    """
    of_constant = ("knows", "friction", "grip", "tyres") if speed.constant else ()
    for name in ("risk", "preview", *of_constant):
        if getattr(speed, name) != getattr(type(speed)(), name):
            raise ScenarioError(
                f"{origin}: speed.{name} has no effect while {reason}, or leave out `{name}`"
            )


def why_unused(speed: Speed) -> str | None:
    """Say why the reference speed does not use what is known about the road; None if it does."""
    if speed.constant:
        return "speed.constant is True; leave it out in the scenario"
    if speed.knows != "nothing":
        return f"speed.knows is {speed.knows!r}; set it to 'nothing' in the scenario"
    if speed.friction is not None:
        return f"speed.friction is {speed.friction}; leave it out in the scenario"
    return None
