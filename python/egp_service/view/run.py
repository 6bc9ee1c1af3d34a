"""What a recording holds for a viewer: its messages, decoded by the schemas in the file."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from mcap.records import Channel, Footer, Metadata, Schema
from mcap.records import Message as Record
from mcap_protobuf.decoder import DecoderFactory

from egp_service.control.recorded import Damage, RecordingError, missing, records
from egp_service.control.recorder import ABOUT

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from google.protobuf.message import Message
    from numpy.typing import NDArray

_TOPICS = ("/step", "/plant", "/plan", "/scene")


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
    complete: bool = False
    """Whether the recording was read to its end."""
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
        return [str(name) for name in json.loads(self.about["members"])]


def read_run(path: Path) -> RecordedRun:
    """Read a recording of `Recorder` or `egp drive` for a viewer.

    Raises:
        RecordingError: for a file that is no such recording, or has no control step.
        OSError: if the file cannot be read.

    """
    run = RecordedRun()
    end: Footer | Damage | None = None
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    decoders = DecoderFactory()
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
                schema = schemas[channel.schema_id]
                decode = decoders.decoder_for(channel.message_encoding, schema)
                if decode is None:
                    raise RecordingError(
                        f"{path}: expected protobuf messages on {channel.topic}, found "
                        f"{channel.message_encoding!r}"
                    )
                _keep(run, channel.topic, record.log_time, decode(record.data))
    run.complete, run.missing = isinstance(end, Footer), missing(end)
    if not run.about or not run.steps:
        raise RecordingError(
            f"{path}: expected a recording of `egp drive` or `Recorder` with at least one control "
            f"step, found {len(run.steps)} steps and {'the' if run.about else 'no'} metadata "
            f"{ABOUT!r}"
        )
    return run


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
