"""A program that answers vehicles in the place of a replica.

    python tests/service/stranger.py MODE NAME LISTEN CONNECT

It announces the replica NAME at the endpoint LISTEN and answers its keys. With the mode `forge`, it
computes plans and changes them, so that they steer with 0.0123 rad/s. With `replay` and `swap` it
passes questions on to the service at the endpoint CONNECT, and answers the first three with what
the service says. Later it answers with an earlier answer (`replay`), or with the new reply and an
earlier attachment (`swap`).
"""

from __future__ import annotations

import json
import sys
import threading
from importlib.resources import files
from typing import Any

import numpy as np
import zenoh
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from egp_service import _core
from egp_service._core import testing

LIBRARY = str(files("egp_service") / "shipped" / "demo-library.safetensors")
GENUINE = 3


def session(**settings: object) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key.replace("__", "/"), json.dumps(value))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")
    return zenoh.open(config)


def forged(reply: bytes) -> bytes:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(_core.file_descriptor_set()).file:
        pool.Add(file)
    message: Any = message_factory.GetMessageClass(pool.FindMessageTypeByName("egp.v1.StepReply"))()
    message.ParseFromString(reply)
    inputs = np.frombuffer(message.plan_u.data, "<f8").reshape(-1, 2).copy()
    inputs[:, 1] = 0.0123
    message.plan_u.data = inputs.tobytes()
    data: bytes = message.SerializeToString()
    return data


def main(mode: str, name: str, listen: str, connect: str) -> None:
    engine = _core.Engine(LIBRARY)
    service = session(connect__endpoints=[connect], listen__endpoints=[])
    front = session(listen__endpoints=[listen])
    genuine: list[tuple[bytes, bytes]] = []

    def relay(query: zenoh.Query) -> None:
        """Pass a question on, with what is attached to it."""
        payload = None if query.payload is None else query.payload.to_bytes()
        attachment = None if query.attachment is None else query.attachment.to_bytes()
        for reply in service.get(query.key_expr, payload=payload, attachment=attachment):
            if reply.ok is None or reply.ok.attachment is None:
                continue
            new = (reply.ok.payload.to_bytes(), reply.ok.attachment.to_bytes())
            if str(query.key_expr).endswith("/ready"):
                answer = new
            else:
                genuine.append(new)
                old = genuine[-2] if len(genuine) > GENUINE else new
                answer = old if mode == "replay" else (new[0], old[1])
            query.reply(query.key_expr, answer[0], attachment=answer[1])

    def answer(query: zenoh.Query) -> None:
        step = not str(query.key_expr).endswith("/ready")
        if mode != "forge" or (not step and query.attachment is not None and name == "main"):
            relay(query)
        elif not step:
            query.reply(query.key_expr, engine.ready)
        elif query.payload is not None:
            query.reply(query.key_expr, forged(engine.step(query.payload.to_bytes())))

    answering = zenoh.handlers.Callback(answer, indirect=True)
    # Both declarations end when they are garbage-collected.
    queryable = front.declare_queryable(f"egp/v1/r/{name}/**", answering, complete=True)
    token = front.liveliness().declare_token(testing.live_key(name))
    threading.Event().wait()
    del queryable, token


if __name__ == "__main__":
    main(*sys.argv[1:])
