"""Recordings of control steps in MCAP, which Foxglove and PlotJuggler open without this package.

`docs/recordings.md` describes the topics.
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from itertools import starmap
from numbers import Real
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final, cast

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from egp_service._core import InvalidArgumentError, vector_instructions
from egp_service.control.messages import message_class
from egp_service.control.step import Closing, Step, StepController, check_type
from egp_service.control.step_record import measured_state, step_record
from egp_service.control.toml_text import dumps
from egp_service.files import replacing
from egp_service.quantities import P_X, P_Y, PSI

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from google.protobuf.message import Message
    from numpy.typing import ArrayLike, NDArray

NANOSECONDS: Final = 1_000_000_000
LATEST: Final = 2**63 / NANOSECONDS
"""Times of a recording are below this one, s, which is 292 years."""
MAP, VEHICLE = "map", "vehicle"
FLUSH_STEPS: Final = 50
"""The recording of a process that was killed lacks at most this many of the last steps."""
ABOUT, SETTINGS, SCENARIO = "egp.about", "egp.settings", "egp.scenario"
"""Names of the metadata records."""


class Recorder(Closing):
    """An open recording of a controller's steps; a context manager.

    It works with every controller, on a simulated and on a real vehicle::

        with Recorder("run.mcap", controller) as recorder:
            while driving:
                step = controller.step(x, reference, widths)
                recorder.add(step, x, time)

    The file holds what is needed to repeat the steps: the requests and replies as sent, the
    identity of the library, the settings and the versions (`egp replay`). The settings of a service
    are known to the recorder only if it was started by this package. The recording of a process
    that was killed can be read except for at most its last 50 steps. After a power failure more of
    them are missing: the system writes them to the disk later. An exception while it is written to,
    such as that of a full disk, ends the recording.
    """

    def __init__(
        self,
        path: str | Path,
        controller: StepController,
        *,
        notes: Mapping[str, Mapping[str, str]] | None = None,
    ) -> None:
        """Create the file `path` for the steps of `controller`, in place of one that is there.

        Where `path` is a symbolic link, the file to which it leads is replaced.

        `notes` are further metadata records, each a name with a mapping of texts.

        Raises:
            OSError: if the file cannot be written; a file that is there then stays as it is.
            TypeError: for a controller or notes of another type.
            InvalidArgumentError: for notes that are no texts or have the name of a record of the
                recorder; a file that is there then stays as it is.

        """
        check_type("controller", controller, StepController)
        about = _about(controller) | _checked_notes(notes or {})
        self._path = path
        self._channels: dict[str, int] = {}
        self._steps = 0
        self._last = 0.0
        self._ended = "it is closed"
        with ExitStack() as failed:
            with replacing(Path(path)) as beside:
                self._file = _File(beside, path)
                failed.callback(self._file.close)
                self._writer = Writer(cast("IO[bytes]", self._file))
                self._writer.start(profile="egp.v1", library="egp-service")
                for name, texts in about.items():
                    self._writer.add_metadata(name, texts)
                self._flush()
            failed.pop_all()

    def add(self, step: Step, x: ArrayLike, time: float) -> None:
        """Record one control period.

        `x` is the measured state (7,), `[p_x, p_y, v_x, psi, v_y, omega, delta]` in SI units and
        rad, `time` the time since the start of the recording in s.

        Raises:
            TypeError: for a step or a time of another type.
            InvalidArgumentError: for a time that is negative, below that of the step before, above
                292 years or not finite, for a state of another shape, and after the end of the
                recording; nothing is then recorded.
            OSError: if the file cannot be written to, which ends the recording.

        """
        check_type("step", step, Step)
        self._check_open_at(time)
        if time < self._last:
            raise InvalidArgumentError(
                f"the time {time} s is before that of the last step, {self._last} s: use a clock "
                "that does not run backward, such as `time.monotonic`"
            )
        state = measured_state(x)
        request, reply = message_class("StepRequest"), message_class("StepReply")
        replies = [*step.late, *([] if step.reply is None else [step.reply])]
        # What is written is made first, so that an exception leaves no part of a step.
        messages = [("/request", request, step.request)] if step.request else []
        messages += [("/reply", reply, data) for data in replies]
        for topic, message in _described(step, state, time):
            messages.append((topic, type(message), message.SerializeToString()))
        with self._whole():
            self._write(messages, time)
            self._last = time
            self._steps += 1
            if self._steps % FLUSH_STEPS == 0:
                self._flush()

    def message(self, topic: str, message: Message, time: float) -> None:
        """Record a protobuf message on a topic of its own.

        `time` is the time since the start of the recording in s, which may be before that of the
        last step.

        Raises:
            InvalidArgumentError: for a time that is negative, above 292 years or not finite, and
                after the end of the recording; nothing is then recorded.
            OSError: if the file cannot be written to, which ends the recording.

        """
        self._check_open_at(time)
        data = message.SerializeToString()
        with self._whole():
            self._write([(topic, type(message), data)], time)

    def _check_open_at(self, time: float) -> None:
        """Raise `InvalidArgumentError` if the recording has ended or cannot state the time."""
        if self._file.closed:
            raise InvalidArgumentError(
                f"the recording has ended, because {self._ended}: make another `Recorder`"
            )
        check_type("time", time, Real)
        if not 0.0 <= time < LATEST:
            raise InvalidArgumentError(
                f"expected for time the seconds since the start of the recording, from 0 to less "
                f"than {LATEST:.3g}, got {time}"
            )

    def _write(self, messages: Sequence[tuple[str, type[Message], bytes]], time: float) -> None:
        stamp = round(time * NANOSECONDS)
        for topic, kind, data in messages:
            if topic not in self._channels:
                self._channels[topic] = self._writer.register_channel(
                    topic,
                    message_encoding="protobuf",
                    schema_id=register_schema(self._writer, kind),
                )
            self._writer.add_message(self._channels[topic], stamp, data, stamp)

    def _flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._file.good = self._file.tell()

    @contextmanager
    def _whole(self) -> Iterator[None]:
        """End the recording with what was written last as a whole if an exception comes."""
        try:
            yield
        except BaseException as error:
            self._ended = f"writing it was interrupted by {error!r}"
            self._file.cut()
            raise

    def close(self) -> None:
        """Complete the file with its index.

        Raises:
            OSError: if the file cannot be written.

        """
        if not self._file.closed:
            with self._whole():
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.close()

    def __repr__(self) -> str:
        """Return the file and the number of steps in one line, and whether it was closed."""
        steps = f"{self._steps} step{'' if self._steps == 1 else 's'}"
        return f"<Recorder of {self._path}: {steps}{', closed' if self._file.closed else ''}>"


class _File:
    """An unbuffered file of which the part up to `good` can be kept."""

    def __init__(self, path: Path, name: str | Path) -> None:
        """Open the file `path`, which errors call `name`, because it is renamed."""
        self._raw = path.open("wb", buffering=0)
        self._name = str(name)
        self.good = 0
        self.tell, self.close = self._raw.tell, self._raw.close

    @property
    def closed(self) -> bool:
        """Whether the file is closed."""
        return self._raw.closed

    def write(self, data: bytes) -> int:
        """Write all of the data."""
        rest = memoryview(data)
        while rest:
            try:
                rest = rest[self._raw.write(rest) :]
            except OSError as error:
                error.filename = self._name
                raise
        return len(data)

    def flush(self) -> None:
        """Do nothing, as there is no buffer."""

    def cut(self) -> None:
        """Keep the good part, and close the file."""
        if not self._raw.closed:
            self._raw.truncate(self.good)
            self._raw.close()


def _described(
    step: Step, state: NDArray[np.float64], time: float
) -> Iterator[tuple[str, Message]]:
    """Give the messages that show a step, with their topics."""
    yield "/step", step_record(step, state, time)
    stamp = timestamp(time)
    if np.isfinite(state).all():
        pose = _pose(*state[[P_X, P_Y, PSI]])
        yield "/pose", PoseInFrame(timestamp=stamp, frame_id=MAP, pose=pose)
        transform = FrameTransform(
            timestamp=stamp,
            parent_frame_id=MAP,
            child_frame_id=VEHICLE,
            translation=pose.position,
            rotation=pose.orientation,
        )
        yield "/tf", transform
    if step.plan_x is not None:
        poses = list(starmap(_pose, step.plan_x[:, [P_X, P_Y, PSI]]))
        yield "/plan", PosesInFrame(timestamp=stamp, frame_id=MAP, poses=poses)


def _checked_notes(notes: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, str]]:
    """Return the notes if they can be written."""
    check_type("notes", notes, Mapping)
    checked = {}
    for name, texts in notes.items():
        if name in (ABOUT, SETTINGS):
            raise InvalidArgumentError(f"notes: {name} is a record of the recorder; rename it")
        try:
            checked[name] = dict(texts)
            for text in (name, *checked[name], *checked[name].values()):
                text.encode()
        except (TypeError, ValueError, AttributeError) as error:
            raise InvalidArgumentError(
                f"notes: expected a mapping of texts for {name!r}, got {texts!r} ({error})"
            ) from error
    return checked


def timestamp(time: float) -> Timestamp:
    """Return the protobuf timestamp of a time in s."""
    stamp = Timestamp()
    stamp.FromNanoseconds(round(time * NANOSECONDS))
    return stamp


def _about(controller: StepController) -> dict[str, dict[str, str]]:
    """Give the metadata that identify what computed the steps."""
    about = {
        "version": version("egp-service"),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "vector_instructions": vector_instructions(),
        "library": controller.library.hex(),
        "library_file": str(controller.library_file or ""),
        "members": json.dumps(list(controller.members)),
        "dt": repr(controller.dt),
        "horizon": str(controller.horizon),
    }
    if controller.settings is None:
        return {ABOUT: about}
    stated = dumps(controller.stated_settings)
    return {ABOUT: about, SETTINGS: {"all": dumps(controller.settings), "stated": stated}}


def _pose(p_x: float, p_y: float, psi: float) -> Pose:
    half = 0.5 * psi
    return Pose(
        position=Vector3(x=p_x, y=p_y), orientation=Quaternion(z=math.sin(half), w=math.cos(half))
    )
