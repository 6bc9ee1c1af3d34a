"""Reading recordings of control steps, also those that were interrupted."""

from __future__ import annotations

import json
import struct
import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel, Footer, Message, Metadata
from mcap.stream_reader import StreamReader

from egp_service._core import EgpError, decode_request
from egp_service.control.messages import message_class
from egp_service.control.recorder import ABOUT, NANOSECONDS, SCENARIO, SETTINGS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from typing import BinaryIO

    from mcap.records import McapRecord
    from numpy.typing import NDArray


class RecordingError(EgpError):
    """A recording that cannot be read, or cannot be replayed."""


@dataclass(frozen=True, slots=True)
class RecordedStep:
    """A request that was sent, with the reply that it got."""

    time: float
    """Time since the start of the recording, s."""
    x: NDArray[np.float64]
    """Measured state (7,)."""
    request: bytes
    reply: bytes | None
    """`None` if no reply came."""


@dataclass(frozen=True)
class Recorded:
    """The control steps of a recording and what computed them."""

    about: Mapping[str, str]
    """Versions, machine and library, as `Recorder` writes them."""
    settings: Mapping[str, object] | None
    """All settings of the control step; `None` if the recorder did not know them."""
    stated_settings: Mapping[str, object]
    """Settings that do not have their default."""
    scenario: str | None
    """The scenario of a simulated run as TOML."""
    steps: list[RecordedStep]
    complete: bool
    """Whether the recording was ended; otherwise it lacks the last steps before an interruption."""

    @property
    def members(self) -> list[str]:
        """Surfaces, in the order of the weights."""
        return [str(name) for name in json.loads(self.about["members"])]


def read_recording(path: Path) -> Recorded:
    """Read a recording of `Recorder` or `egp drive`.

    Raises:
        RecordingError: for a file that is no such recording.
        OSError: if the file cannot be read.

    """
    metadata: dict[str, Mapping[str, str]] = {}
    topics: dict[int, str] = {}
    requests: list[tuple[float, bytes]] = []
    replies: dict[int, bytes] = {}
    complete = False
    sequence_of = message_class("StepReply").FromString
    for record in records(path):
        if isinstance(record, Metadata):
            metadata[record.name] = record.metadata
        elif isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Footer):
            complete = True
        elif isinstance(record, Message):
            topic = topics.get(record.channel_id)
            if topic == "/request":
                requests.append((record.log_time / NANOSECONDS, record.data))
            elif topic == "/reply":
                replies[sequence_of(record.data).sequence] = record.data
    if ABOUT not in metadata:
        raise RecordingError(
            f"{path}: expected a recording with the metadata {ABOUT!r}, found none; recordings of "
            "earlier versions cannot be replayed: drive again with `egp drive`"
        )
    settings = metadata.get(SETTINGS)
    scenario = metadata.get(SCENARIO)
    return Recorded(
        about=metadata[ABOUT],
        settings=None if settings is None else tomllib.loads(settings["all"]),
        stated_settings={} if settings is None else tomllib.loads(settings["stated"]),
        scenario=None if scenario is None else scenario["toml"],
        steps=[_step(time, request, replies) for time, request in requests],
        complete=complete,
    )


def write_requests(recorded: Recorded, file: BinaryIO) -> None:
    """Write the requests as `egp-load --requests` reads them: each behind its length as a varint.

    Raises:
        RecordingError: if there are no requests.
        OSError: if the file cannot be written.

    """
    if not recorded.steps:
        raise RecordingError("no requests to write: expected a recording with at least one step")
    file.writelines(_varint(len(step.request)) + step.request for step in recorded.steps)


def _varint(number: int) -> bytes:
    """Give seven bits a byte, the lowest first, with the highest bit set in all but the last."""
    groups = bytearray()
    while number >> 7:
        groups.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*groups, number])


def _step(time: float, request: bytes, replies: Mapping[int, bytes]) -> RecordedStep:
    sent = decode_request(request)
    return RecordedStep(time, np.asarray(sent.x), request, replies.get(sent.sequence))


def records(path: Path) -> Iterator[McapRecord]:
    """Give the records of an MCAP file up to its end, or up to where it was cut off.

    Raises:
        RecordingError: for a file that is not MCAP.
        OSError: if the file cannot be read.

    """
    begun = False
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream, validate_crcs=True).records:
                begun = True
                yield record
        except (McapError, EOFError, struct.error, ValueError) as error:
            if not begun:
                raise RecordingError(f"{path}: expected an MCAP recording: {error!r}") from error
