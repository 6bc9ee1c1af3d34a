"""Messages of recordings: bags of ROS 1 and 2, and MCAP files with ROS 2, Protobuf or JSON."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from typing import TYPE_CHECKING, Any, Final

from mcap.decoder import DecoderFactory
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoderFactory

from egp_service._core import EgpError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from mcap.records import Schema
    from rosbags.typesys.store import Typestore

    Decoder = Callable[[bytes], Any]

_BAGS: Final = {".bag", ".db3"}
_MCAP: Final = ".mcap"


def is_recording(path: Path) -> bool:
    """Whether a path is a bag's folder or has the suffix of a recording."""
    return path.is_dir() or path.suffix in {_MCAP, *_BAGS}


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

    Raises:
        EgpError: if there is no such file, it is no recording, or it is not complete; also while
            its messages are read.

    """
    if not path.exists():
        raise EgpError(f"{path}: no such file or folder")
    with contextlib.ExitStack() as stack:
        with _foreign(path):
            mcap = path.suffix == _MCAP and path.is_file()
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
    reader = make_reader(file, decoder_factories=[ProtobufDecoderFactory(), _Json(), _Ros2()])
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise EgpError(
            f"{path}: the recording has no summary, because it was interrupted; `mcap recover` "
            "(of the MCAP command line tool) writes one"
        )
    counts = summary.statistics.channel_message_counts
    topics: dict[str, tuple[str, int]] = {}
    for channel in summary.channels.values():
        schema = summary.schemas.get(channel.schema_id)
        kind = schema.name if schema else channel.message_encoding
        _, before = topics.get(channel.topic, (kind, 0))
        topics[channel.topic] = (kind, before + counts.get(channel.id, 0))

    def read(chosen: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
        for _, channel, record, message in reader.iter_decoded_messages(topics=chosen):
            yield channel.topic, record.log_time, message

    return Messages(topics, read)


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
