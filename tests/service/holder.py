"""A program that offers a library as a replica does, but answers wrongly.

    python tests/service/holder.py MODE LISTEN LIBRARY

It answers for the replica `stray` at the endpoint LISTEN, with the file LIBRARY under its SHA-256.
The mode says what is wrong: `noise` (no message), `large` (states more bytes than a library may
have), `long` and `short` (parts of a wrong length), `wrong` (one other byte), `half` (it ends in
the middle), `silent` (it does not answer a part), or nothing with `honest`.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import threading
from pathlib import Path

import zenoh

PART_BYTES = 65536
TOO_LARGE = (1 << 29) + 1


def varint(value: int) -> bytes:
    digits = bytearray()
    while value > 0x7F:
        digits.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*digits, value])


def main(mode: str, listen: str, library: str) -> None:
    content = Path(library).read_bytes()
    key = f"egp/v1/r/stray/library/{hashlib.sha256(content).hexdigest()}"
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([listen]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")
    kept = []

    def answer(query: zenoh.Query) -> None:
        if query.selector.key_expr.intersects(zenoh.KeyExpr(key)):
            size = TOO_LARGE if mode == "large" else len(content)
            # The fields `version` and `bytes` of egp.v1.LibraryFile.
            message = b"\x08\x01\x10" + varint(size)
            query.reply(key, b"\xff" if mode == "noise" else message)
            return
        number = int(str(query.key_expr).rpartition("/")[2])
        part = bytearray(content[number * PART_BYTES : (number + 1) * PART_BYTES])
        if mode == "half" and number == 2:
            os._exit(0)
        if mode == "silent" and number == 1:
            kept.append(query)  # zenoh ends a question whose query was dropped
            return
        if mode == "wrong" and number == 1:
            part[100] ^= 1
        if mode == "long":
            part += b"0"
        if mode == "short":
            del part[-1]
        query.reply(query.key_expr, bytes(part))

    with zenoh.open(config) as session:
        queryable = session.declare_queryable(
            "egp/v1/r/stray/**", zenoh.handlers.Callback(answer, indirect=True), complete=True
        )
        threading.Event().wait()
        del queryable


if __name__ == "__main__":
    main(*sys.argv[1:])
