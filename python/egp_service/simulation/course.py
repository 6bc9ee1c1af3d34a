"""The course of a scenario: its path with friction zones, and the reference speed along it."""

from __future__ import annotations

import hashlib
import inspect
import json
from functools import partial
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np

from egp_service._core import (
    GRAVITY,
    EgpError,
    InvalidArgumentError,
    Library,
    Path,
    SpeedProfile,
)
from egp_service.simulation.scenario import (
    Scenario,
    leave_distance,
    library_path,
    vehicle_parameters,
)
from egp_service.simulation.scenario_checks import ScenarioError, check_seed

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

# A long lap with fast and slow corners of both directions.
_CIRCUIT_SEED = 11
# m; roads of other lengths have no belief about their friction.
_LENGTHS = (1.0, 1e6)
# m from the path to an edge; a request states no larger distance.
_FARTHEST_EDGE = 1000.0
# rad; a path counts as straight where a car steers less. The splines of straight roads need 1.5e-3.
_STRAIGHT = 2.5e-3


def _circle(radius: float = 50.0, track_width: float = 7.0) -> Path:
    """Return a counter-clockwise circle that starts in the direction +x.

    Raises:
        InvalidArgumentError: unless the radius is positive.
        EgpError: if the width is negative.

    """
    if not radius > 0.0:
        raise InvalidArgumentError(f"expected a radius above 0 m, got {radius:g}")
    angle = np.linspace(-0.5 * np.pi, 1.5 * np.pi, 72, endpoint=False)
    points = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return Path.from_points(points, closed=True, widths=np.full((72, 2), 0.5 * track_width))


TRACKS: dict[str, Callable[..., Path]] = {
    "circle": _circle,
    "circuit": partial(Path.random, _CIRCUIT_SEED),
    "rounded-rectangle": Path.rounded_rectangle,
    "l-shape": Path.l_shape,
    "lane-change": Path.lane_changes,
    "iso-3888-2": Path.iso_3888_2,
    "random": Path.random,
    "csv": Path.from_csv,
}


def build_path(scenario: Scenario, origin: str | None = None) -> Path:
    """Path of the scenario's track, with widths and friction zones.

    Raises:
        ScenarioError: with a message that begins with `origin`, or else the scenario's name, if
            track or parameters are unknown, dimensions or the file are invalid, a zone begins
            behind the end of the path, or laps are stated for a track that is not closed.
        EgpError: if the scenario's file of a vehicle cannot be used.

    """
    where = scenario.name if origin is None else origin
    path = _path(scenario, where)
    if scenario.laps != 1.0 and not path.closed:
        raise ScenarioError(
            f"{where}: laps is {scenario.laps:g}, which has no effect on a track that is not "
            "closed: leave it out"
        )
    scale = path.length if scenario.zones_in_metres else 1.0
    for number, zone in enumerate(scenario.zones):
        if scenario.zones_in_metres and zone.start >= path.length:
            raise ScenarioError(
                f"{where}: zones[{number}].start is {zone.start:g} m, but the path is "
                f"{path.length:g} m long: expected less"
            )
    return path.with_friction([(zone.start / scale, *zone.sides()) for zone in scenario.zones])


def _path(scenario: Scenario, where: str) -> Path:
    """Path of the scenario's track without friction zones."""
    track = scenario.track
    if track.kind not in TRACKS:
        raise ScenarioError(
            f"{where}: track.kind: no track {track.kind!r}; known: {', '.join(TRACKS)}"
        )
    parameters: dict[str, object] = dict(track.parameters)
    make = TRACKS[track.kind]
    known = [name for name in inspect.signature(make).parameters if name not in ("file", "closed")]
    if unknown := sorted(set(parameters) - set(known)):
        raise ScenarioError(
            f"{where}: track.parameters.{unknown[0]}: unknown for kind {track.kind!r}; "
            f"known: {', '.join(known)}"
        )
    if track.kind == "csv":
        if track.file is None:
            raise ScenarioError(f"{where}: track.file is missing, which track kind 'csv' needs")
        parameters |= {"file": track.file, "closed": track.closed is not False}
    if track.kind == "iso-3888-2":
        car = vehicle_parameters(scenario)
        parameters.setdefault("vehicle_width", car.width)
    if track.kind == "random":
        seed = track.parameters.get("seed", scenario.seed)
        check_seed(seed, f"{where}: track.parameters.seed")
        parameters["seed"] = int(seed)
    key = "track.file" if track.kind == "csv" else "track.parameters"
    try:
        path = make(**parameters)
    except (EgpError, OSError) as error:
        raise ScenarioError(f"{where}: {key}: {error}") from error
    least, most = _LENGTHS
    made = f" of {track.file}" if track.file else ""
    if not least <= path.length <= most:
        raise ScenarioError(
            f"{where}: {key}: the path{made} is {path.length:g} m long: expected {least:g} to "
            f"{most:g} m"
        )
    _, _, _, _, left, right, _ = path.sample(np.arange(0.0, path.length, 0.5))
    edge = np.maximum(left, right).max()
    if _FARTHEST_EDGE < edge < np.inf:  # it is infinite without edges
        units = "; check the unit of the file, and track.parameters.scale" if track.file else ""
        raise ScenarioError(
            f"{where}: {key}: an edge{made} is {edge:g} m from the path: expected at most "
            f"{_FARTHEST_EDGE:g} m{units}"
        )
    return path


def narrow_place(scenario: Scenario) -> str | None:
    """Say where the scenario's road is narrower than its vehicle; None if it is not."""
    path, width = build_path(scenario), vehicle_parameters(scenario).width
    s = np.arange(0.0, path.length, 0.5)
    _, _, _, _, left, right, _ = path.sample(s)
    narrowest = int((left + right).argmin())
    road = left[narrowest] + right[narrowest]
    if road >= width:
        return None
    return (
        f"The road is {road:.2f} m wide at {s[narrowest]:.0f} m of the path, less than the "
        f"vehicle's {width:.2f} m: check the track's widths. The drive goes on as long as the car "
        f"is within leave_distance, {leave_distance(scenario):g} m, of the path"
    )


def tight_place(scenario: Scenario) -> str | None:
    """Say where the scenario's path turns tighter than its vehicle can; None if it does not."""
    path, car = build_path(scenario), vehicle_parameters(scenario)
    s = np.arange(0.0, path.length, 0.1)
    curvature = np.abs(path.sample(s)[3])
    tightest = int(curvature.argmax())
    smallest = (car.l_f + car.l_r) / np.tan(car.steering_angle)
    if curvature[tightest] * smallest <= 1.0:
        return None
    advice = "smooth the points of its file" if scenario.track.file else "make the track larger"
    return (
        f"The path turns with a radius of {1.0 / curvature[tightest]:.2f} m at s = "
        f"{s[tightest]:.1f} m, where the car cannot follow it, because the smallest radius that "
        f"the vehicle steers is {smallest:.2f} m: {advice}"
    )


def start_state(scenario: Scenario, path: Path, speed: float) -> NDArray[np.float64]:
    """State `[p_x, p_y, v_x, psi, v_y, omega, delta]` at the start of the path, `speed` m/s ahead.

    The vehicle drives steadily along the path's curvature, or the largest that it can follow at
    this speed. Both axles slip by the angle at which their tyres transmit the lateral acceleration.
    Their force rises, as that of brush tyres, three times as steeply as its peak over `peak_slip`.
    """
    sample = path.sample(np.zeros(1))
    x, y, yaw, curvature, _, _, friction = (float(column[0]) for column in sample)
    car = vehicle_parameters(scenario)
    if abs(np.arctan((car.l_f + car.l_r) * curvature)) < _STRAIGHT:
        return np.array([x, y, speed, yaw, 0.0, 0.0, 0.0])
    grip = car.lateral_grip * GRAVITY
    tightest = np.tan(car.steering_angle) / (car.l_f + car.l_r)
    largest = min(tightest, grip * friction / max(speed**2, 1e-9))  # the car may stand
    curvature = np.clip(curvature, -largest, largest)
    slip = speed**2 * curvature / grip * car.peak_slip / 3.0
    # Of the velocities of the centre of mass and the axles relative to the body's x axis.
    course = car.l_r * curvature - np.tan(slip)
    steering = slip + np.arctan(course + car.l_f * curvature)
    delta = np.clip(steering, -car.steering_angle, car.steering_angle)
    omega = curvature * speed * np.hypot(1.0, course)
    return np.array([x, y, speed, yaw - np.arctan(course), speed * course, omega, delta])


def build_profile(scenario: Scenario, path: Path) -> SpeedProfile:
    """Return the speed profile for `speed.grip` of each zone's friction, at most `speed.v_max`."""
    if scenario.speed.constant:
        return SpeedProfile.constant(path, scenario.speed.v_max)
    car = vehicle_parameters(scenario)
    speed = scenario.speed
    return SpeedProfile(path, car, speed.grip, speed.v_max, tyres=tyre_grips(scenario))


def tyre_grips(scenario: Scenario) -> NDArray[np.float64] | None:
    """Return the members' frictions and lateral grips (n, 2), the least of each friction.

    None if the scenario's speed does not depend on them.

    Raises:
        LibraryError: if the scenario's library cannot be read.
        OSError: if the scenario's library cannot be read.

    """
    if not scenario.speed.tyres:
        return None
    members = Library.load(library_path(scenario)).members
    grips: dict[float, float] = {}
    for member in members:
        known = grips.get(member.friction, float("inf"))
        grips[member.friction] = min(known, member.lateral_grip)
    return np.array(sorted(grips.items()))


def road_name(scenario: Scenario) -> str:
    """Name the scenario's road by its track, so that vehicles on the same track name it alike.

    The friction is no part of it. The same file of a track gives the same name wherever it is.
    """
    track = scenario.track
    content = b"" if track.file is None else FilePath(track.file).read_bytes()
    seed = {"seed": float(scenario.seed)} if track.kind == "random" else {}
    ends = {"closed": 0.0} if track.closed is False else {}
    shape = sorted({**seed, **ends, **track.parameters}.items())
    text = json.dumps([track.kind, hashlib.sha256(content).hexdigest(), shape])
    return f"{track.kind}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"
