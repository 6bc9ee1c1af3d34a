"""What a recording holds for a viewer."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import DecodeError
from mcap.records import Channel, Footer, Metadata, Schema
from mcap.records import Message as Record

from egp_service.control.messages import message_class
from egp_service.control.recorded import (
    Damage,
    RecordingError,
    check_about,
    member_names,
    missing,
    records,
)
from egp_service.control.recorder import ABOUT

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from google.protobuf.message import Message
    from numpy.typing import NDArray

_TOPICS: Mapping[str, type[Message]] = {
    "/step": message_class("StepRecord"),
    "/plant": message_class("PlantTruth"),
    "/plan": PosesInFrame,
    "/scene": SceneUpdate,
}


@dataclass
class RecordedRun:
    """The messages of a recording that a viewer shows, by their time in ns since its start."""

    about: Mapping[str, str] = field(default_factory=dict)
    """Versions, machine and library, as `Recorder` writes them."""
    steps: dict[int, Message] = field(default_factory=dict)
    """`egp.v1.StepRecord` of each control period."""
    truths: dict[int, Message] = field(default_factory=dict)
    """`egp.v1.PlantTruth` of each control period; empty without a simulated plant."""
    plans: dict[int, NDArray[np.float32]] = field(default_factory=dict)
    """Positions (n, 2) of each new plan, m."""
    scene: Message | None = None
    """`foxglove.SceneUpdate` with road and car; `None` without a simulated road."""
    missing: str = ""
    """Sentence about what is missing because of an interruption or a damage; empty if complete."""

    @property
    def poses(self) -> dict[int, tuple[float, float, float]]:
        """Measured `p_x`, `p_y` in m and `psi` in rad, where all three are finite."""
        rows = {time: (step.p_x, step.p_y, step.psi) for time, step in self.steps.items()}
        return {time: row for time, row in rows.items() if np.isfinite(row).all()}

    @property
    def members(self) -> list[str]:
        """Surfaces, in the order of the weights."""
        return member_names(self.about["members"])


def read_run(path: Path) -> RecordedRun:
    """Read a recording of `Recorder` or `egp drive` for a viewer.

    Raises:
        RecordingError: for a file that is no such recording, has no control step, or does not
            name its members.
        OSError: if the file cannot be read.

    """
    try:
        run = _read(path)
    except (KeyError, DecodeError) as error:
        raise RecordingError(f"{path}: the recording is damaged ({error!r})") from error
    if not run.about or not run.steps:
        raise RecordingError(
            f"{path}: expected a recording of `egp drive` or `Recorder` with at least one control "
            f"step, found {len(run.steps)} steps and {'the' if run.about else 'no'} metadata "
            f"{ABOUT!r}"
        )
    check_about(path, run.about, "members")
    return run


def _read(path: Path) -> RecordedRun:
    run = RecordedRun()
    end: Footer | Damage | None = None
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    for record in records(path):
        if isinstance(record, Metadata) and record.name == ABOUT:
            run.about = record.metadata
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Footer | Damage):
            end = record
        elif isinstance(record, Record):
            channel = channels[record.channel_id]
            if channel.topic in _TOPICS:
                kind = _kind(path, channel, schemas.get(channel.schema_id))
                _keep(run, channel.topic, record.log_time, kind.FromString(record.data))
    run.missing = missing(end)
    return run


def _kind(path: Path, channel: Channel, schema: Schema | None) -> type[Message]:
    """Return the class of a topic's messages, or raise if the recording has others on it."""
    kind = _TOPICS[channel.topic]
    expected, found = str(kind.DESCRIPTOR.full_name), "no type" if schema is None else schema.name
    if found != expected or channel.message_encoding != "protobuf":
        raise RecordingError(
            f"{path}: expected {expected} as 'protobuf' on {channel.topic}, found {found} as "
            f"{channel.message_encoding!r}: give a recording of `egp drive` or `Recorder`"
        )
    return kind


def _keep(run: RecordedRun, topic: str, time: int, message: Message) -> None:
    if topic == "/step":
        run.steps[time] = message
    elif topic == "/plant":
        run.truths[time] = message
    elif topic == "/scene":
        run.scene = message
    else:
        places = [(pose.position.x, pose.position.y) for pose in message.poses]
        run.plans[time] = np.array(places, dtype=np.float32).reshape(-1, 2)
