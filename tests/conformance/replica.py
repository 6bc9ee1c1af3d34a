"""A replica that answers with the real control step, with the faults that its script prescribes.

As a program it is a replica on the network::

    python tests/conformance/replica.py NAME ENDPOINT SCRIPT.json

A script maps the name of a fault to the sequence numbers of the requests that it befalls, or to
"always". The faults of `READY_FAULTS` befall the answers of the `ready` key instead, which are
counted from 1.
"""

from __future__ import annotations

import functools
import json
import random
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from egp_service import _core
from egp_service._core import testing

LIBRARY = str(files("egp_service") / "shipped" / "demo-library.safetensors")


Script: TypeAlias = Mapping[str, list[int] | Literal["always"]]
READY_FAULTS = {"noise_in_ready", "draining", "weaker_vehicle"}
_ENCODING = "application/protobuf;egp.v1."


@dataclass(frozen=True, slots=True)
class Answer:
    """A replica's answer: payload, error, or neither (silence).

    `ended` is a closed query, and `unended` one that stays open behind its payload.
    """

    payload: bytes = b""
    attachment: bytes = b""
    error: bytes = b""
    ended: bool = False
    unended: bool = False


def message(name: str) -> Any:  # noqa: ANN401 - classes made at run time
    """Make an empty message of the wire."""
    return _message_class(name)()


@functools.cache
def _message_class(name: str) -> Any:  # noqa: ANN401
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(_core.file_descriptor_set()).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"egp.v1.{name}"))


class ScriptedReplica:
    """Answers requests; `script` maps faults to sequence numbers."""

    def __init__(self, script: Script) -> None:
        """Load the library."""
        self.engine = _core.Engine(LIBRARY)
        self._script = script
        self._replies: dict[int, bytes] = {}
        self._described = 0
        self._noise = random.Random(0)  # noqa: S311 - not for secrets

    def ready(self) -> bytes:
        """Describe the library, as the service's `ready` key does, or as its fault says."""
        self._described += 1
        fault = self._fault(self._described, ready=True)
        if fault == "noise_in_ready":
            return self._noise.randbytes(500)
        description = message("Ready")
        description.ParseFromString(self.engine.ready)
        if fault == "draining":
            description.ready = False
        elif fault == "weaker_vehicle":
            description.vehicle.a_max = 1.0
        data: bytes = description.SerializeToString()
        return data

    def answer(self, request: bytes) -> Answer:  # noqa: PLR0911 - one for each fault
        """Answer one request correctly or with its fault."""
        sequence = _core.decode_request(request).sequence
        fault = self._fault(sequence, ready=False)
        reply = self.engine.step(request)
        self._replies[sequence] = reply
        match fault:
            case "" | "unended":
                return Answer(reply, _timing(), unended=bool(fault))
            case "silence":
                return Answer()
            case "empty":
                return Answer(ended=True)
            case "noise":
                return Answer(self._noise.randbytes(500))
            case "noise_in_error":
                return Answer(error=b"\xff" * 40)
            case "noise_in_attachment":
                return Answer(reply, b"\xff" * 9)
            case "internal_error" | "invalid_field":
                error = message("Error")
                error.code, error.detail = {
                    "internal_error": (9, "a defect"),
                    "invalid_field": (3, "a value outside its domain"),
                }[fault]
                return Answer(error=error.SerializeToString())
            case "old_reply":
                return Answer(self._replies[sequence - 2], _timing())
            case "large":
                return Answer(bytes(30_000_000))
        return Answer(_changed(reply, fault), _timing())

    def _fault(self, number: int, *, ready: bool) -> str:
        """Give the fault of the description or of the reply with this number; empty if none."""
        for name, befallen in self._script.items():
            if (name in READY_FAULTS) == ready and (befallen == "always" or number in befallen):
                return name
        return ""


def _changed(reply: bytes, fault: str) -> bytes:
    changed = message("StepReply")
    changed.ParseFromString(reply)
    if fault == "three_weights":
        _fill(changed.weights, np.array([0.5, 0.25, 0.25]))
    elif fault == "far_plan":
        _fill(changed.plan_x, np.full(tuple(changed.plan_x.shape), 1e8))
    elif fault == "huge_predictions":
        shape = tuple(changed.history_f.shape) or (1, 2, 3)
        _fill(changed.history_f, np.full(shape, 1e308))
    elif fault == "other_plan":
        plan = np.frombuffer(changed.plan_x.data, "<f8").reshape(tuple(changed.plan_x.shape))
        _fill(changed.plan_x, plan + 1.0)
    elif fault == "other_library":
        changed.library = bytes(32)
    else:
        raise ValueError(f"no fault {fault!r}")
    data: bytes = changed.SerializeToString()
    return data


def _fill(tensor: Any, values: Any) -> None:  # noqa: ANN401
    tensor.shape[:] = values.shape
    tensor.data = values.astype("<f8").tobytes()


def _timing() -> bytes:
    timing = message("Timing")
    timing.step_us = 250
    data: bytes = timing.SerializeToString()
    return data


def serve(name: str, endpoint: str, script: Script) -> None:
    """Be a replica on the network until the process is killed."""
    import zenoh  # noqa: PLC0415 - the in-process transport does without

    replica = ScriptedReplica(script)
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")
    config.insert_json5("transport/link/tx/lease", "2000")
    session = zenoh.open(config)

    def on_query(query: Any) -> None:  # noqa: ANN401
        key = str(query.key_expr)
        if key == testing.ready_key(name):
            query.reply(key, replica.ready(), encoding=_ENCODING + "Ready")
            return
        answer = replica.answer(query.payload.to_bytes())
        if answer.error:
            query.reply_err(answer.error, encoding=_ENCODING + "Error")
        elif answer.payload:
            extra, encoding = answer.attachment or None, _ENCODING + "StepReply"
            query.reply(key, answer.payload, attachment=extra, encoding=encoding)
        if answer.unended or not (answer.error or answer.payload or answer.ended):
            kept.append(query)  # a query that is never dropped is never answered

    kept: list[Any] = []
    answering = zenoh.handlers.Callback(on_query, indirect=True)
    # Both declarations end when they are garbage-collected.
    queryable = session.declare_queryable(f"egp/v1/r/{name}/**", answering, complete=True)
    token = session.liveliness().declare_token(testing.live_key(name))
    print("serving", flush=True)
    threading.Event().wait()
    del queryable, token


if __name__ == "__main__":
    serve(sys.argv[1], sys.argv[2], json.loads(Path(sys.argv[3]).read_text(encoding="utf-8")))
