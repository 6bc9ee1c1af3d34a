"""Reading recordings of control steps, also those that were interrupted."""

from __future__ import annotations

import json
import math
import os
import re
import reprlib
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np
from google.protobuf.message import DecodeError
from mcap.records import Channel, Chunk, Footer, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from egp_service._core import EgpError, decode_request
from egp_service.control.messages import message_class
from egp_service.control.recorder import ABOUT, NANOSECONDS, SCENARIO, SETTINGS
from egp_service.control.step import EqualByValue

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from typing import BinaryIO

    from mcap.records import McapRecord
    from numpy.typing import NDArray


class RecordingError(EgpError):
    """A recording that cannot be read, or cannot be replayed."""


@dataclass(frozen=True, slots=True)
class Damage:
    """Where a recording cannot be read on, although it goes on or was ended."""

    at: int
    """First byte that was not read."""
    behind: int
    """Number of bytes from there to the end."""
    reason: str

    def __str__(self) -> str:
        """Say where the damage is and what is missing."""
        return (
            f"damaged at byte {self.at} ({self.reason}); the {self.behind} bytes from there on "
            "were not read"
        )


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class RecordedStep(EqualByValue):
    """A request that was sent, with the reply that it got."""

    time: float
    """Time since the start of the recording, s."""
    x: NDArray[np.float64]
    """Measured state (7,)."""
    request: bytes
    reply: bytes | None
    """`None` if no reply came."""

    def __repr__(self) -> str:
        """Return time and sizes in one line."""
        reply = "no reply" if self.reply is None else f"reply of {len(self.reply)} bytes"
        return f"<RecordedStep at {self.time:g} s: request of {len(self.request)} bytes, {reply}>"


@dataclass(frozen=True, repr=False, eq=False)
class Recorded(EqualByValue):
    """The control steps of a recording and what computed them."""

    about: Mapping[str, str]
    """Versions, machine and library, as `Recorder` writes them."""
    settings: Mapping[str, object] | None
    """All settings of the control step; `None` if they were not available to the recorder."""
    stated_settings: Mapping[str, object]
    """Settings that do not have their default."""
    scenario: str | None
    """The scenario of a simulated run as TOML."""
    steps: list[RecordedStep]
    complete: bool
    """Whether the recording was read to its end."""
    missing: str = ""
    """Sentence about what is missing because of an interruption or a damage; empty if complete."""

    def __repr__(self) -> str:
        """Return members, period and the number of steps in one line."""
        return (
            f"<Recorded of {', '.join(self.members)}: dt {self.dt:g} s, horizon {self.horizon}, "
            f"{len(self.steps)} steps{'' if self.complete else ', incomplete'}>"
        )

    @property
    def members(self) -> list[str]:
        """Surfaces, in the order of the weights."""
        return member_names(self.about["members"])

    @property
    def dt(self) -> float:
        """Control period, s."""
        return _period(self.about["dt"])

    @property
    def horizon(self) -> int:
        """Number of periods that are planned."""
        return _horizon(self.about["horizon"])


_HASH: Final = re.compile("[0-9a-f]{64}")
_LONGEST_HORIZON: Final = 128
"""Largest horizon of a message."""


def member_names(text: str) -> list[str]:
    """Read the names of the members, a list in JSON; `ValueError` for anything else."""
    try:
        names = json.loads(text)
    except RecursionError:
        raise ValueError("too deep") from None
    if not (isinstance(names, list) and names and all(isinstance(name, str) for name in names)):
        raise ValueError("not a list of texts")
    "".join(names).encode()  # half of a surrogate pair cannot be shown
    return names


def _library(text: str) -> str:
    if _HASH.fullmatch(text) is None:
        raise ValueError("not a hash")
    return text


def _period(text: str) -> float:
    seconds = float(text)
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise ValueError("not a period")
    return seconds


def _horizon(text: str) -> int:
    periods = int(text)
    if not 1 <= periods <= _LONGEST_HORIZON:
        raise ValueError("out of range")
    return periods


_ABOUT: Final[Mapping[str, tuple[Callable[[str], object], str]]] = MappingProxyType(
    {
        "library": (_library, "the SHA-256 of the library as 64 lower-case hexadecimal digits"),
        "members": (member_names, "the names of the members as a JSON list of texts"),
        "dt": (_period, "the control period in s, a number above 0"),
        "horizon": (_horizon, f"a whole number from 1 to {_LONGEST_HORIZON}"),
    }
)
"""The keys of `ABOUT` without which a recording cannot be replayed, each with the function that
reads its text, and what this function expects."""


def check_about(path: Path, about: Mapping[str, str], *keys: str) -> None:
    """Raise `RecordingError` unless the metadata `ABOUT` have these keys with usable values."""
    for key in keys:
        read, expected = _ABOUT[key]
        found = f"{key} is missing"
        if key in about:
            try:
                read(about[key])
            except ValueError:
                found = f"{key} is {reprlib.repr(about[key])}"
            else:
                continue
        raise RecordingError(f"{path}: metadata {ABOUT!r}: {found}: expected {expected}")


def missing(end: Footer | Damage | None) -> str:
    """Return a sentence about what a recording lacks, empty if its last record is the footer."""
    if isinstance(end, Damage):
        return f"The recording is {end}."
    return "" if end else "The recording was interrupted; its last steps are missing."


def read_recording(path: str | Path) -> Recorded:
    """Read a recording of `Recorder` or `egp drive`.

    Raises:
        RecordingError: for a file that is no such recording.
        OSError: if the file cannot be read.

    """
    try:
        return _read(Path(path))
    except RecordingError:
        raise
    except (KeyError, ValueError, DecodeError, EgpError) as error:
        raise RecordingError(f"{path}: the recording is damaged ({error!r})") from error


def _read(path: Path) -> Recorded:
    metadata: dict[str, Mapping[str, str]] = {}
    topics: dict[int, str] = {}
    steps: list[RecordedStep] = []
    # A reply is to the newest request of its number; a second controller begins with 1 again.
    asked: dict[int, int] = {}
    end: Footer | Damage | None = None
    sequence_of = message_class("StepReply").FromString
    for record in records(path):
        if isinstance(record, Metadata):
            metadata[record.name] = record.metadata
        elif isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Footer | Damage):
            end = record
        elif isinstance(record, Message):
            topic = topics.get(record.channel_id)
            if topic == "/request":
                sent = decode_request(record.data)
                asked[sent.sequence] = len(steps)
                time = record.log_time / NANOSECONDS
                steps.append(RecordedStep(time, np.asarray(sent.x), record.data, None))
            elif topic == "/reply":
                index = asked.get(sequence_of(record.data).sequence)
                if index is not None:
                    steps[index] = replace(steps[index], reply=record.data)
    if ABOUT not in metadata:
        raise RecordingError(
            f"{path}: expected a recording with the metadata {ABOUT!r}, found none; recordings of "
            "earlier versions cannot be replayed: drive again with `egp drive`"
        )
    check_about(path, metadata[ABOUT], *_ABOUT)
    settings = metadata.get(SETTINGS)
    scenario = metadata.get(SCENARIO)
    return Recorded(
        about=metadata[ABOUT],
        settings=None if settings is None else tomllib.loads(settings["all"]),
        stated_settings={} if settings is None else tomllib.loads(settings["stated"]),
        scenario=None if scenario is None else scenario["toml"],
        steps=steps,
        complete=isinstance(end, Footer),
        missing=missing(end),
    )


def write_requests(recorded: Recorded, file: BinaryIO) -> None:
    """Write the requests for `egp-load --requests`, each behind its length as a varint."""
    file.writelines(_varint(len(step.request)) + step.request for step in recorded.steps)


def _varint(number: int) -> bytes:
    """Give seven bits a byte, the lowest first, with the highest bit set in all but the last."""
    groups = bytearray()
    while number >> 7:
        groups.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*groups, number])


def records(path: Path) -> Iterator[McapRecord | Damage]:
    """Give the records of an MCAP file up to its end, or up to where it was cut off.

    If it cannot be read to there, the last thing given is the damage.

    Raises:
        RecordingError: for a file that is not MCAP.
        OSError: if the file cannot be read.

    """
    read = 0
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream, emit_chunks=True, validate_crcs=True).records:
                if isinstance(record, Chunk):
                    yield from breakup_chunk(record, validate_crc=True)
                else:
                    yield record
                read = stream.tell()
        except OSError:
            raise
        except Exception as error:  # of many kinds, for damaged files
            if read == 0:
                size = stream.seek(0, os.SEEK_END)
                raise RecordingError(
                    f"{path}: expected an MCAP recording, got {size} bytes that do not begin as one"
                ) from error
            stopped, size = stream.tell(), stream.seek(0, os.SEEK_END)
            stream.seek(-len(MCAP0_MAGIC), os.SEEK_END)
            # A file that was cut off ends within a record, and not with the mark of the end.
            if stopped < size or stream.read() == MCAP0_MAGIC:
                yield Damage(read, size - read, str(error) or type(error).__name__)
