"""Classes of the wire's messages, for recordings; the steps themselves are coded in Rust."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from egp_service._core import file_descriptor_set

if TYPE_CHECKING:
    from google.protobuf.message import Message


@cache
def _pool() -> DescriptorPool:
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(file_descriptor_set()).file:
        pool.Add(file)
    return pool


@cache
def message_class(name: str) -> type[Message]:
    """Return the class of the message `egp.v1.NAME`."""
    found: type[Message] = GetMessageClass(_pool().FindMessageTypeByName(f"egp.v1.{name}"))
    return found
