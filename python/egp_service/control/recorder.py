"""Recordings of control steps in MCAP, which Foxglove and PlotJuggler open without this package.

`docs/recordings.md` describes the topics.
"""

from __future__ import annotations

import json
import math
import platform
from importlib.metadata import version
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

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
from egp_service.control.step_record import step_record
from egp_service.control.toml_text import dumps
from egp_service.quantities import NX, P_X, P_Y, PSI

if TYPE_CHECKING:
    from collections.abc import Mapping

    from google.protobuf.message import Message
    from numpy.typing import ArrayLike, NDArray

    from egp_service.control.step import Step, StepController

NANOSECONDS: Final = 1_000_000_000
LATEST: Final = 2**63 / NANOSECONDS
"""Times of a recording are below this one, s, which is 292 years."""
MAP, VEHICLE = "map", "vehicle"
FLUSH_STEPS: Final = 50
"""An interrupted recording lacks at most this many of the last steps."""
ABOUT, SETTINGS, SCENARIO = "egp.about", "egp.settings", "egp.scenario"
"""Names of the metadata records."""


class Recorder:
    """An open recording of a controller's steps; a context manager.

    It works with every controller, on a simulated and on a real vehicle::

        with Recorder("run.mcap", controller) as recorder:
            while driving:
                step = controller.step(x, reference, widths)
                recorder.add(step, x, time)

    The file holds what is needed to repeat the steps: the requests and replies as sent, the
    identity of the library, the settings and the versions (`egp replay`). The settings of a service
    are known to the recorder only if it was started by this package. What was recorded before an
    interruption stays readable.
    """

    def __init__(
        self,
        path: str | Path,
        controller: StepController,
        *,
        notes: Mapping[str, Mapping[str, str]] | None = None,
    ) -> None:
        """Create the file `path` for the steps of `controller`.

        `notes` are further metadata records, each a name with a mapping of texts. Raises `OSError`
        if the file cannot be written.
        """
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._channels: dict[str, int] = {}
        self._steps = 0
        about = _about(controller) | dict(notes or {})
        self._stream = path.open("wb")
        try:
            self._writer = Writer(self._stream)
            self._writer.start(profile="egp.v1", library="egp-service")
            for name, texts in about.items():
                self._writer.add_metadata(name, dict(texts))
            self._writer.flush()  # type: ignore[no-untyped-call]
        except BaseException:
            self._stream.close()
            path.unlink()  # it has no header, or nothing else
            raise

    def add(self, step: Step, x: ArrayLike, time: float) -> None:
        """Record one control period.

        `x` is the measured state (7,), `[p_x, p_y, v_x, psi, v_y, omega, delta]` in SI units and
        rad, `time` the time since the start of the recording in s. Raises `InvalidArgumentError`,
        and records nothing, for a time that is negative, above 292 years or not finite, for a state
        of another shape, and after `close`.
        """
        state = self._checked(x, time)
        self.encoded("/request", "StepRequest", time, [step.request] if step.request else [])
        replies = [*step.late, *([] if step.reply is None else [step.reply])]
        self.encoded("/reply", "StepReply", time, replies)
        self.message("/step", step_record(step, state, time), time)
        if np.isfinite(state).all():
            pose = _pose(*state[[P_X, P_Y, PSI]])
            stamp = timestamp(time)
            self.message("/pose", PoseInFrame(timestamp=stamp, frame_id=MAP, pose=pose), time)
            transform = FrameTransform(
                timestamp=stamp,
                parent_frame_id=MAP,
                child_frame_id=VEHICLE,
                translation=pose.position,
                rotation=pose.orientation,
            )
            self.message("/tf", transform, time)
        if step.plan_x is not None:
            poses = list(starmap(_pose, step.plan_x[:, [P_X, P_Y, PSI]]))
            plan = PosesInFrame(timestamp=timestamp(time), frame_id=MAP, poses=poses)
            self.message("/plan", plan, time)
        self._steps += 1
        if self._steps % FLUSH_STEPS == 0:
            self._writer.flush()  # type: ignore[no-untyped-call]

    def _checked(self, x: ArrayLike, time: float) -> NDArray[np.float64]:
        """Return the state as an array; nothing of a step is written before all of it is valid."""
        if self._stream.closed:
            raise InvalidArgumentError(
                "the recording is closed: add its steps before `close`, or make another `Recorder`"
            )
        if not 0.0 <= time < LATEST:
            raise InvalidArgumentError(
                f"expected for time the seconds since the start of the recording, from 0 to less "
                f"than {LATEST:.3g}, got {time}"
            )
        try:
            state = np.asarray(x, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InvalidArgumentError(f"expected numbers for x, got {x!r}: {error}") from error
        if state.shape != (NX,):
            raise InvalidArgumentError(f"expected x of shape ({NX},), got {state.shape}")
        return state

    def message(self, topic: str, message: Message, time: float) -> None:
        """Record a protobuf message on a topic of its own."""
        self._write(topic, type(message), time, message.SerializeToString())

    def encoded(self, topic: str, name: str, time: float, messages: list[bytes]) -> None:
        """Record messages `egp.v1.NAME` as the bytes that were exchanged."""
        for data in messages:
            self._write(topic, message_class(name), time, data)

    def _write(self, topic: str, kind: type[Message], time: float, data: bytes) -> None:
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(
                topic, message_encoding="protobuf", schema_id=register_schema(self._writer, kind)
            )
        stamp = round(time * NANOSECONDS)
        self._writer.add_message(self._channels[topic], stamp, data, stamp)

    def close(self) -> None:
        """Complete the file with its index."""
        if not self._stream.closed:
            try:
                self._writer.finish()  # type: ignore[no-untyped-call]
            finally:
                self._stream.close()

    def __enter__(self) -> Self:
        """Use as a context manager to complete the file at the end."""
        return self

    def __exit__(self, *_: object) -> None:
        """Complete the file, also after an error."""
        self.close()


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
