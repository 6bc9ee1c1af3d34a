"""A recorded run as entities of Rerun, on the timeline `time` since the start of the recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from egp_service.control.recorder import MAP, VEHICLE
from egp_service.view.scene import log_scene

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from google.protobuf.message import Message
    from numpy.typing import ArrayLike, NDArray

    from egp_service.view.run import RecordedRun

    Colour = tuple[int, int, int]

TIMELINE: Final = "time"
CAR: Final = "map/car"
"""Entity that moves with the measured pose."""
_GREY, _ORANGE, _BLUE, _GREEN = (156, 163, 175), (232, 106, 43), (75, 163, 199), (106, 153, 78)
_STEP_CURVES: Final = (
    ("speed/measured", "measured", "v_x", _GREY),
    ("friction/lower", "found, 5 %", "friction_lower", _BLUE),
    ("friction/upper", "found, 95 %", "friction_upper", _GREEN),
    ("force/command", "command", "force", _GREY),
    ("steering/angle", "angle", "delta", _GREY),
    ("steering/rate", "rate, command", "steering_rate", _ORANGE),
    ("times/total", "request to command", "total_ms", _GREY),
    ("times/compute", "computing", "compute_ms", _ORANGE),
    ("times/queue", "waiting", "queue_ms", _BLUE),
)
"""Entity, name in the legend, field of `StepRecord` and colour."""
_TRUTH_CURVES: Final = (
    ("lateral/error", "lateral error", "lateral_error", _GREY),
    ("speed/reference", "reference", "speed_reference", _ORANGE),
    ("friction/true", "true", "friction", _GREY),
    ("friction/planned", "planned for", "friction_planned", _ORANGE),
)
"""Entity, name in the legend, field of `PlantTruth` and colour."""
_STATES: Final = {
    "mode": {"normal": _GREEN, "tail": _BLUE, "waiting": _GREY, "stop": _ORANGE},
    "status": {"solved": _GREEN},
}
"""Colours of modes and statuses; the viewer chooses those of all others."""
_ABOVE: Final = 0.05
"""Height of lines above the road, which would otherwise hide them, m."""
_ARROW, _RADIUS = 4.0, 0.4
"""Length and radius of the arrow in place of a car whose size was not recorded, m."""


def log_run(recording: rr.RecordingStream, run: RecordedRun) -> None:
    """Log everything of a run that the layout shows."""
    recording.send_property("recorded", rr.AnyValues(drop_untyped_nones=True, **run.about))
    _log_map(recording, run)
    _log_car(recording, run)
    for messages, curves in ((run.steps, _STEP_CURVES), (run.truths, _TRUTH_CURVES)):
        for path, name, field, colour in curves if messages else ():
            values = [getattr(message, field) for message in messages.values()]
            _log_curve(recording, path, rr.SeriesLines(names=name, colors=colour), messages, values)
    for i, member in enumerate(run.members):
        path = f"weights/{rr.escape_entity_path_part(member)}"
        # There are no weights before the first reply.
        known = {time: step for time, step in run.steps.items() if i < len(step.weights)}
        values = [step.weights[i] for step in known.values()]
        _log_curve(recording, path, rr.SeriesLines(names=member), known, values)
    _log_states(recording, run.steps)


def _log_map(recording: rr.RecordingStream, run: RecordedRun) -> None:
    """Log the road, and the new plan of each period; a period without one shows none."""
    recording.log(MAP, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if run.scene is not None:
        log_scene(recording, run.scene, {MAP: MAP, VEHICLE: CAR})
    style = rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(2.0), colors=_BLUE)
    recording.log(f"{MAP}/plan", style, static=True)
    strips = [_above_road(plan) for plan in run.plans.values()]
    planned = [time in run.plans for time in run.steps]
    columns = rr.LineStrips3D.columns(strips=strips).partition(planned)
    recording.send_columns(f"{MAP}/plan", [_times(run.steps)], columns)


def _log_car(recording: rr.RecordingStream, run: RecordedRun) -> None:
    """Log the measured poses and the line through them."""
    if run.scene is None:
        arrow = rr.Arrows3D(
            origins=[(0.0, 0.0, _RADIUS)],
            vectors=[(_ARROW, 0.0, 0.0)],
            radii=_RADIUS,
            colors=_ORANGE,
        )
        recording.log(f"{CAR}/arrow", arrow, static=True)
    poses = np.array(list(run.poses.values()), dtype=np.float64).reshape(-1, 3)
    half, zero = 0.5 * poses[:, 2], np.zeros(len(poses))
    columns = rr.Transform3D.columns(
        translation=_above_road(poses[:, :2]),
        quaternion=np.column_stack([zero, zero, np.sin(half), np.cos(half)]),
    )
    recording.send_columns(CAR, [_times(run.poses)], columns)
    line = rr.LineStrips3D(
        [_above_road(poses[:, :2])], radii=rr.Radius.ui_points(0.75), colors=_ORANGE
    )
    recording.log(f"{MAP}/trajectory", line, static=True)


def _log_curve(
    recording: rr.RecordingStream,
    path: str,
    style: rr.SeriesLines,
    times: Iterable[int],
    values: ArrayLike,
) -> None:
    recording.log(path, style, static=True)
    recording.send_columns(path, [_times(times)], rr.Scalars.columns(scalars=values))


def _log_states(recording: rr.RecordingStream, steps: Mapping[int, Message]) -> None:
    """Log mode and status where they change, also as a text with the reason."""
    for name, colours in _STATES.items():
        path = f"state/{name}"
        style = rr.StateConfiguration(values=list(colours), colors=list(colours.values()))
        recording.log(path, style, static=True)
        changes = _changes({time: getattr(step, name) for time, step in steps.items()})
        columns = rr.StateChange.columns(state=list(changes.values()))
        recording.send_columns(path, [_times(changes)], columns)
    changes = _changes({time: _text(step) for time, step in steps.items()})
    columns = rr.TextLog.columns(text=list(changes.values()))
    recording.send_columns("changes", [_times(changes)], columns)


def _text(step: Message) -> str:
    words = f"{step.mode}, {step.status}"
    return f"{words}: {step.detail}" if step.detail else words


def _changes(values: Mapping[int, str]) -> dict[int, str]:
    """Give the values that differ from the one before them."""
    before = [None, *values.values()]
    pairs = zip(before, values.items(), strict=False)
    return {time: value for last, (time, value) in pairs if value != last}


def _times(nanoseconds: Iterable[int]) -> rr.TimeColumn:
    return rr.TimeColumn(TIMELINE, duration=np.array(list(nanoseconds), dtype="timedelta64[ns]"))


def _above_road(places: NDArray[np.floating]) -> NDArray[np.floating]:
    """Add the third coordinate to positions (n, 2)."""
    return np.column_stack([places, np.full(len(places), _ABOVE)])
