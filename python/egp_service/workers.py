"""Processes that work in parallel and end with what they work for."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from concurrent.futures import Executor


Part = TypeVar("Part")
Result = TypeVar("Result")


@contextmanager
def workers(jobs: int | None = None) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of `jobs` processes, one per core by default.

    An exception inside, such as Ctrl-C raises, ends them at once. A bare pool would first finish
    what its processes have taken up, and Ctrl-C, which a terminal sends to all of them, would only
    make each of them take up the next. Killed, this process takes them along.
    """
    others = set(multiprocessing.active_children())
    # Spawned, not forked: a fork would copy thread pools half.
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs or os.cpu_count(), spawn, _begin) as pool:
        try:
            yield pool
        except BaseException:
            # The pool's thread fails what is queued and reaps them; reaping here would race it.
            # With a writer left it would wait for ever for the rest of a result cut off.
            pool._result_queue._writer.close()  # type: ignore[attr-defined]  # noqa: SLF001
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise


def in_order(
    pool: Executor, work: Callable[[Part], Result], parts: Iterable[Part]
) -> Iterator[Result]:
    """Give the results of `work` on `parts`, in their order.

    As `pool.map` does, which however cancels what is left when interrupted, and a pool whose
    processes end then fails at that (CPython 3.11).
    """
    for future in [pool.submit(work, part) for part in parts]:
        yield future.result()


def _begin() -> None:
    """Leave interruptions to the parent, and do not outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # a result that nobody takes is no news
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
