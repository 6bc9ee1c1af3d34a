"""The number of threads of a training's linear algebra."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Final

import torch
from threadpoolctl import threadpool_limits

if TYPE_CHECKING:
    from collections.abc import Iterator

_LARGEST_SINGLE_THREADED: Final = 1000  # points of a member


@contextlib.contextmanager
def one_thread(points: int) -> Iterator[None]:
    """Use one thread of torch and of numpy's BLAS for small matrices.

    Further threads would only busy-wait, and beside other programs wait for processors. They also
    change the order of sums, and so the last bits of a library, which would then depend on the
    number of processors.
    """
    if points > _LARGEST_SINGLE_THREADED:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(before)
