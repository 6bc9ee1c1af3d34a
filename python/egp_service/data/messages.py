"""Messages of recordings: bags of ROS 1 and 2, and MCAP files with ROS 2, Protobuf or JSON."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import logging
from collections import Counter
from typing import TYPE_CHECKING, Any, Final

from mcap.decoder import DecoderFactory
from mcap.reader import make_reader
from mcap.records import Channel, Footer, Message, Schema
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoderFactory

from egp_service._core import EgpError
from egp_service.control.recorded import Damage, records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from mcap.records import McapRecord
    from rosbags.typesys.store import Typestore

    Decoder = Callable[[bytes], Any]

_BAGS: Final = {".bag", ".db3"}
_MCAP: Final = ".mcap"
_INDEX: Final = "metadata.yaml"
_log = logging.getLogger(__name__)


def is_recording(path: Path) -> bool:
    """Whether a path is a bag's folder or has the suffix of a recording."""
    return path.is_dir() or path.suffix.lower() in {_MCAP, *_BAGS}


def check_folder(path: Path) -> None:
    """Raise `EgpError` for a folder that is no bag of ROS 2."""
    if path.is_dir() and not (path / _INDEX).is_file():
        raise EgpError(
            f"{path}: this folder is no bag of ROS 2, in which there is a file {_INDEX}: name the "
            "folder of a bag, or the file of a log"
        )


@dataclasses.dataclass(frozen=True)
class Messages:
    """The messages of an open recording."""

    topics: dict[str, tuple[str, int]]
    """Type and number of the messages of each topic."""
    read: Callable[[Sequence[str]], Iterator[tuple[str, int, Any]]]
    """Returns topic, time of recording in ns and message, of the topics that are given."""


@contextlib.contextmanager
def open_recording(path: Path) -> Iterator[Messages]:
    """Open a bag's folder, a `.bag`, `.db3` or `.mcap` file.

    An MCAP file that was interrupted is read up to there, and a warning says so.

    Raises:
        EgpError: if there is no such file, it is no recording or damaged, or a bag is not complete;
            also while its messages are read.

    """
    if not path.exists():
        raise EgpError(f"{path}: no such file or folder")
    check_folder(path)
    with contextlib.ExitStack() as stack:
        with _foreign(path):
            if path.is_file() and path.suffix.lower() in _BAGS - {path.suffix}:
                raise EgpError(
                    f"{path}: bags are read by names that end in lower case only: rename it to "
                    f"{path.with_suffix(path.suffix.lower()).name}"
                )
            mcap = path.suffix.lower() == _MCAP and path.is_file()
            opened = (_mcap if mcap else _bag)(path, stack)

        def read(chosen: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
            messages = opened.read(chosen)
            while True:
                with _foreign(path):
                    try:
                        message = next(messages)
                    except StopIteration:
                        return
                yield message

        yield Messages(opened.topics, read)


@contextlib.contextmanager
def _foreign(path: Path) -> Iterator[None]:
    """Turn what the readers of a format raise into one error.

    They raise many kinds for a damaged file, assertions and missing keys among them.
    """
    try:
        yield
    except (EgpError, ImportError):
        raise
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise EgpError(f"{path}: not a readable recording ({reason})") from error


def _bag(path: Path, stack: contextlib.ExitStack) -> Messages:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    reader = stack.enter_context(AnyReader([path], default_typestore=store))
    topics = {
        topic: (info.msgtype or "several types", info.msgcount)
        for topic, info in reader.topics.items()
    }

    def read(chosen: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
        connections = [c for c in reader.connections if c.topic in chosen]
        for connection, time, raw in reader.messages(connections):
            yield connection.topic, time, reader.deserialize(raw, connection.msgtype)

    return Messages(topics, read)


def _mcap(path: Path, stack: contextlib.ExitStack) -> Messages:
    file = stack.enter_context(path.open("rb"))
    decoders = [ProtobufDecoderFactory(), _Json(), _Ros2()]
    reader = make_reader(file, validate_crcs=True, decoder_factories=decoders)
    summary = None
    with contextlib.suppress(Exception):  # of many kinds, where there is no index
        summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        return _without_index(path, decoders)

    def read(chosen: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
        for _, channel, record, message in reader.iter_decoded_messages(topics=chosen):
            yield channel.topic, record.log_time, message

    counts = summary.statistics.channel_message_counts
    return Messages(_topics(summary.channels, summary.schemas, counts), read)


def _content(path: Path) -> tuple[dict[int, Schema], dict[int, Channel], Counter[int]]:
    """Return what an MCAP file without index contains, with the number of each channel's messages.

    A damaged file is an error.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    counts: Counter[int] = Counter()
    record: McapRecord | Damage | None = None
    for record in records(path):
        if isinstance(record, Message):
            counts[record.channel_id] += 1
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
    if isinstance(record, Damage):
        raise EgpError(f"{path}: the recording is {record}")
    if not isinstance(record, Footer):
        _log.warning("%s was interrupted; its last messages are missing", path)
    return schemas, channels, counts


def _without_index(path: Path, factories: Sequence[DecoderFactory]) -> Messages:
    """Return the messages of an MCAP file that has no index, up to where it was interrupted."""
    schemas, channels, counts = _content(path)

    def decoder(channel: Channel) -> Decoder:
        schema = schemas.get(channel.schema_id)
        for factory in factories:
            if decode := factory.decoder_for(channel.message_encoding, schema):
                return decode
        raise EgpError(f"{path}: {channel.topic} has the encoding {channel.message_encoding!r}")

    def read(chosen: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
        wanted = {key: channel for key, channel in channels.items() if channel.topic in chosen}
        decoders = {key: decoder(channel) for key, channel in wanted.items()}
        for record in records(path):
            if isinstance(record, Message) and record.channel_id in wanted:
                message = decoders[record.channel_id](record.data)
                yield wanted[record.channel_id].topic, record.log_time, message

    return Messages(_topics(channels, schemas, counts), read)


def _topics(
    channels: Mapping[int, Channel], schemas: Mapping[int, Schema], counts: Mapping[int, int]
) -> dict[str, tuple[str, int]]:
    topics: dict[str, tuple[str, int]] = {}
    for channel in channels.values():
        schema = schemas.get(channel.schema_id)
        kind = schema.name if schema else channel.message_encoding
        _, before = topics.get(channel.topic, (kind, 0))
        topics[channel.topic] = (kind, before + counts.get(channel.id, 0))
    return topics


class _Json(DecoderFactory):
    def decoder_for(self, message_encoding: str, schema: Schema | None) -> Decoder | None:  # noqa: ARG002
        return json.loads if message_encoding == "json" else None


class _Ros2(DecoderFactory):
    """CDR with the definitions that the file states, as `ros2 bag record` writes them."""

    def decoder_for(self, message_encoding: str, schema: Schema | None) -> Decoder | None:
        if message_encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
            return None
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store: Typestore = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(schema.data.decode(), schema.name))
        name = schema.name
        return lambda raw: store.deserialize_cdr(raw, name)
