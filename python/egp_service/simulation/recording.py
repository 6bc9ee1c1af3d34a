"""Recordings in MCAP: requests and replies as the bytes on the wire, and the plant's true state.

The files contain their schemas and open in Foxglove and PlotJuggler. The service keeps no state, so
sending the recorded requests again gives the same replies.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Self

from mcap.writer import Writer

from egp_service._core import encode_plant_truth, file_descriptor_set
from egp_service.files import replacing

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from egp_service.simulation.trace import Period

NANOSECONDS = 1_000_000_000
TOPICS = {
    "/request": "egp.v1.StepRequest",
    "/reply": "egp.v1.StepReply",
    "/plant": "egp.v1.PlantTruth",
}


class Recording:
    """An open recording; log times are seconds since the start of the run."""

    def __init__(self, writer: Writer) -> None:
        """Register schemas and channels with a started `writer`."""
        self._writer = writer
        schemas = file_descriptor_set()
        self._channels = {
            topic: writer.register_channel(
                topic,
                message_encoding="protobuf",
                schema_id=writer.register_schema(name, "protobuf", schemas),
            )
            for topic, name in TOPICS.items()
        }

    @classmethod
    @contextmanager
    def create(cls, path: Path) -> Iterator[Self]:
        """Record to `path`, where the file is created when the recording is complete."""
        with replacing(path) as beside, beside.open("wb") as stream:
            writer = Writer(stream)
            writer.start(profile="egp.v1", library="egp-service")
            yield cls(writer)
            writer.finish()  # type: ignore[no-untyped-call]

    def add(self, period: Period) -> None:
        """Record one control period."""
        truth, step = period.truth, period.step
        for late in step.late:
            self._message("/reply", late, truth.time)
        if step.request:
            self._message("/request", step.request, truth.time)
        if step.reply is not None:
            self._message("/reply", step.reply, truth.time)
        message = encode_plant_truth(
            time=truth.time,
            state=truth.x,
            u=step.u.tolist(),
            friction=truth.friction,
            path_s=truth.path_s,
            lateral_error=truth.lateral_error,
            heading_error=truth.heading_error,
            speed_reference=truth.speed_reference,
            mode=step.mode,
            weights=step.weights.tolist(),
            friction_planned=truth.friction_planned,
        )
        self._message("/plant", message, truth.time)

    def _message(self, topic: str, data: bytes, time: float) -> None:
        stamp = round(time * NANOSECONDS)
        self._writer.add_message(self._channels[topic], stamp, data, stamp)
