"""Columns of a recording: fields of messages, at the times of one topic."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import polars as pl

from egp_service._core import EgpError
from egp_service.data.messages import open_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from egp_service.data.messages import Messages

    Column = NDArray[Any]  # of numbers, or of texts

# Between messages that are farther apart than so many usual periods, nothing is interpolated.
_GAP: Final = 3.0
# A topic may be slower than the control period by this factor.
_SLOWER: Final = 1.1
_REPORTED: Final = 1000  # messages
_LATEST: Final = 2**62  # ns
_STEPS: Final = (
    "/step",
    "/plant",
)  # topics of recordings of `egp_service.Recorder` and `egp drive`
_NUMBER: Final = (bool, int, float, np.number)


def topics(path: str | Path) -> str:
    """List the topics of a recording with their types, for messages; errors as `open_recording`."""
    with open_recording(Path(path)) as messages:
        found = sorted(messages.topics.items())
    return ", ".join(f"{topic} ({kind})" for topic, (kind, _) in found)


def read_fields(
    path: str | Path,
    names: Sequence[str] | None = None,
    dt: float | None = None,
    report: Callable[[int, int], None] | None = None,
) -> pl.DataFrame:
    """Read fields of messages as columns, with the `time` in s since the first row.

    A name is a topic, `/`, and the path of a number or a text in its messages:
    `/odom/twist.twist.linear.x` or `/wheels/speed[0]`; slashes in place of dots are understood as
    well. Without names these are all numbers and texts, but no lists, of the topics `/step` and
    `/plant` of a recording of control steps. A message's time is that of its header
    (`header.stamp`, or the field `stamp` or `timestamp`). If a message of the topic has none, or
    zero, all times of the topic are those of the recording.

    Rows are the messages of the topic of the first name. Numbers of other topics are interpolated
    linearly between their messages, and a text is that of the message before. A row is left out if
    one of them has no message before or after it, or if these are more than three usual periods
    apart. `report` receives the number of messages that were read, and of all.

    Raises:
        EgpError: if no name is in the list or `dt` is not positive, the recording cannot be read, a
            topic or field does not exist or is neither number nor text, a topic has fewer messages
            than one per `dt` seconds, or topics do not overlap in time.

    """
    path = Path(path)
    if isinstance(names, str) or (names is not None and not names):
        raise EgpError(f"names are {names!r}: expected a list of TOPIC/FIELD.FIELD, at least one")
    if dt is not None and not 0.0 < dt < float("inf"):
        raise EgpError(f"dt is {dt}: expected a positive period in s")
    with open_recording(path) as messages:
        names = _plain(messages) if names is None else names
        split = {name: _split(path, name, messages.topics) for name in names}
        wanted = list(dict.fromkeys(topic for topic, _ in split.values()))
        total = sum(messages.topics[topic][1] for topic in wanted)
        signals = {
            topic: _Signal([(name, field) for name, (t, field) in split.items() if t == topic])
            for topic in wanted
        }
        for done, (topic, recorded, message) in enumerate(messages.read(wanted)):
            signals[topic].add(path, recorded, message)
            if report is not None and done % _REPORTED == 0:
                report(done, total)
    if report is not None:
        report(total, total)
    tables = {topic: signal.table(path) for topic, signal in signals.items()}
    return _aligned(path, tables, names, dt)


def _plain(messages: Messages) -> list[str]:
    """Name the numbers and texts of control steps and of the simulated truth."""
    found = []
    for topic in _STEPS:
        if topic in messages.topics:
            first = next(messages.read([topic]), None)
            if first is None:
                continue
            message = first[2]
            plain = (
                f for f in _fields(message) if isinstance(_member(message, f), (str, *_NUMBER))
            )
            found += [f"{topic}/{field}" for field in plain]
    return found or [_STEPS[0]]  # without which an error names the recorded topics


def _split(path: Path, name: str, topics: Iterable[str]) -> tuple[str, list[str]]:
    """Split a name into its topic and the steps to a field."""
    listed = sorted(topics)
    if not listed:
        raise EgpError(
            f"{path}: the recording has no messages: check that it was copied whole, and that "
            "something was recorded"
        )
    found = [topic for topic in listed if name == topic or name.startswith(f"{topic}/")]
    if not found:
        raise EgpError(
            f"{path}: no topic of '{name}' is recorded: expected TOPIC/FIELD.FIELD with one of "
            + ", ".join(listed)
        )
    topic = max(found, key=len)
    return topic, [step for step in re.split(r"[./\[\]]+", name[len(topic) :]) if step]


class _Signal:
    """Fields of one topic, and both times of its messages, ns."""

    def __init__(self, fields: list[tuple[str, list[str]]]) -> None:
        self._fields = fields
        self._stamps: list[int] = []
        self._recorded: list[int] = []
        self._values: list[list[float | str]] = []

    def add(self, path: Path, recorded: int, message: Any) -> None:  # noqa: ANN401
        self._stamps.append(_stamp(message))
        self._recorded.append(recorded)
        self._values.append([_value(path, name, message, steps) for name, steps in self._fields])

    def table(self, path: Path) -> tuple[NDArray[np.int64], dict[str, Column]]:
        """Return the times in ns, which increase, and the values of each column."""
        stamped = all(self._stamps)
        times = np.array(self._stamps if stamped else self._recorded, dtype=np.int64)
        times, first = np.unique(times, return_index=True)
        columns: dict[str, Column] = {}
        for i, (name, _) in enumerate(self._fields):
            values = [row[i] for row in self._values]
            texts = sum(isinstance(value, str) for value in values)
            if 0 < texts < len(values):
                raise EgpError(f"{path}: '{name}' is a text in {texts} of {len(values)} messages")
            columns[name] = np.array(values, dtype=np.str_ if texts else np.float64)[first]
        return times, columns


def _member(value: Any, step: str) -> Any:  # noqa: ANN401
    if step.isdecimal():
        return value[int(step)]
    return value[step] if isinstance(value, dict) else getattr(value, step)


def _fields(value: Any) -> list[str]:  # noqa: ANN401
    """Names of the fields of a message, in ROS 2, Protobuf or JSON."""
    if isinstance(value, dict):
        return list(value)
    if hasattr(value, "DESCRIPTOR"):
        return [field.name for field in value.DESCRIPTOR.fields]
    names = getattr(value, "__dataclass_fields__", ())
    return [name for name in names if not name.startswith("_")]


def _value(path: Path, name: str, message: Any, steps: list[str]) -> float | str:  # noqa: ANN401
    value = message
    for step in steps:
        try:
            value = _member(value, step)
        except IndexError:
            raise EgpError(
                f"{path}: '{name}' has no '{step}': there are {len(value)} entries, from 0 on"
            ) from None
        except (AttributeError, KeyError, TypeError):
            fields = _fields(value)
            found = f"found {', '.join(fields)}" if fields else f"found {type(value).__name__}"
            raise EgpError(f"{path}: '{name}' has no '{step}', {found}") from None
    if isinstance(value, str):
        return value
    if isinstance(value, _NUMBER):
        return float(value)
    fields = _fields(value)
    more = f"add one of its fields, {', '.join(fields)}" if fields else "expected a number or text"
    raise EgpError(f"{path}: '{name}' is no number: {more}")


def _stamp(message: Any) -> int:  # noqa: ANN401
    """Return the time of a message's header in ns, 0 if there is none."""
    for steps in (("header", "stamp"), ("stamp",), ("timestamp",)):
        value = message
        try:
            for step in steps:
                value = _member(value, step)
            for whole, rest in (("sec", "nanosec"), ("seconds", "nanos"), ("sec", "nsec")):
                if whole in _fields(value) and rest in _fields(value):
                    time = int(_member(value, whole)) * 10**9 + int(_member(value, rest))
                    return time if 0 < time < _LATEST else 0
        except (AttributeError, KeyError, TypeError, ValueError):
            continue
    return 0


def _aligned(
    path: Path,
    tables: Mapping[str, tuple[NDArray[np.int64], dict[str, Column]]],
    names: Sequence[str],
    dt: float | None,
) -> pl.DataFrame:
    for topic, (times, _) in tables.items():
        if len(times) < 2:  # noqa: PLR2004
            raise EgpError(f"{path}: {topic} has {len(times)} messages: expected at least two")
        period = float(np.median(np.diff(times))) * 1e-9
        if dt is not None and period > _SLOWER * dt:
            raise EgpError(
                f"{path}: {topic} has a message every {period:.3g} s, which is slower than the "
                f"control period: choose --dt {period:.3g} or longer, or another topic"
            )
    (base, (rows, _)), *others = tables.items()
    kept = np.full(len(rows), fill_value=True)
    for topic, (times, _) in others:
        after = np.searchsorted(times, rows)
        inside = (after > 0) & (after < len(times)) | np.isin(rows, times[[0, -1]])
        if not inside.any():
            raise EgpError(
                f"{path}: the times of {base} ({_span(rows)}) and {topic} ({_span(times)}) do not "
                "overlap: do their stamps come from different clocks?"
            )
        after = np.clip(after, 1, len(times) - 1)
        gaps = times[after] - times[after - 1]
        kept &= inside & (gaps <= _GAP * np.median(np.diff(times)))
    rows = rows[kept]
    if len(rows) == 0:
        raise EgpError(f"{path}: {' and '.join(tables)} have no messages at the same times")
    start = rows[0]
    columns: dict[str, Column] = {"time": (rows - start) * 1e-9}
    for times, values in tables.values():
        before = np.searchsorted(times, rows, side="right") - 1
        for name, value in values.items():
            if value.dtype.kind == "U":
                columns[name] = value[before]
            else:
                columns[name] = np.interp(columns["time"], (times - start) * 1e-9, value)
    return pl.DataFrame({"time": columns["time"]} | {name: columns[name] for name in names})


def _span(times: NDArray[np.int64]) -> str:
    return f"{times[0] * 1e-9:.3f} to {times[-1] * 1e-9:.3f} s"
