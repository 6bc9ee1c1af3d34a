"""Parallel processes on this machine or on a Ray cluster, which end with this process."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
import warnings
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from loky import ProcessPoolExecutor
from loky.process_executor import TerminatedWorkerError

from egp_service._core import EgpError, available_cores

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

Part = TypeVar("Part")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")
_LOOK_SECONDS = 0.2
_CONNECT_SECONDS = 5.0


class WorkerError(EgpError):
    """A process was ended by the system, so that its work has no result."""


@contextmanager
def workers(jobs: int | None = None, cluster: str | None = None) -> Iterator[Executor]:
    """Open a pool of `jobs` processes, or one on a cluster.

    By default there is a process for each core that this process may use.

    `cluster` is the address `HOST:PORT` of a Ray cluster to which this machine belongs. Its
    machines need this version of the package, and the files that the work reads, at the same paths,
    which must be absolute.

    An exception inside, such as that of Ctrl-C, ends the processes and their work immediately. If
    this process is killed, they end, too.

    Raises:
        EgpError: if both `jobs` and `cluster` are given, or there is no cluster at that address.
        WorkerError: if one of the processes was killed.

    """
    if cluster is not None:
        if jobs is not None:
            raise EgpError("a cluster runs as many processes as it has cores: leave out --jobs")
        with _Cluster(cluster) as pool:
            try:
                yield pool
            except pool.lost as error:
                raise WorkerError(
                    "a process of the cluster was ended, perhaps for lack of memory, or because "
                    "its machine was lost: see `ray status`, and run the command again"
                ) from error
        return
    # Where psutil is installed, loky replaces a process that has grown by 300 MB, and warns that it
    # did. A process that has trained has grown by more, and the results stay the same.
    warnings.filterwarnings("ignore", message="A worker", category=UserWarning, module="loky")
    with ProcessPoolExecutor(
        jobs or available_cores(), initializer=_begin, initargs=(os.getpid(),)
    ) as pool:
        try:
            with _interruptions_deferred():
                pool.submit(os.getpid)  # the first call starts all processes
            yield pool
        except BaseException as error:
            pool.shutdown(kill_workers=True)
            if isinstance(error, TerminatedWorkerError):
                raise WorkerError(
                    "a worker process was ended by the system, perhaps for lack of memory; try "
                    "fewer with --jobs N"
                ) from error
            raise


def in_order(
    pool: Executor, work: Callable[[Part], Result], parts: Iterable[Part]
) -> Iterator[Result]:
    """Yield the results of `work` on `parts`, in their order.

    Unlike `pool.map` it does not cancel futures when it is interrupted, because a pool that is shut
    down sets an exception on each of them, which fails for a cancelled one.
    """
    for future in [pool.submit(work, part) for part in parts]:
        yield future.result()


@contextmanager
def _interruptions_deferred() -> Iterator[None]:
    """Block Ctrl-C, which a terminal sends to all processes, in the processes that start here.

    New processes inherit the blocked signal. If another thread of this process receives the signal
    meanwhile, the interruption is raised at the end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread is interrupted, and only it may set a handler
        return
    received: list[int] = []
    resource_tracker.ensure_running()  # unblocks the signal when it starts its process
    handler = signal.signal(signal.SIGINT, lambda number, _: received.append(number))
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        signal.signal(signal.SIGINT, handler)
    if received:
        raise KeyboardInterrupt


def _begin(parent: int) -> None:
    """Make this worker ignore interruptions, which its parent handles, and end with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """Exit when the parent has ended, after which this process has another parent."""
    while os.getppid() == parent:
        time.sleep(_LOOK_SECONDS)
    os._exit(1)


class _Cluster(Executor):
    """The processes of a Ray cluster. Ray ends their work when this process disconnects."""

    def __init__(self, address: str) -> None:
        """Connect to the cluster at `address`, `HOST:PORT`."""
        import ray  # noqa: PLC0415 - comes with an extra

        host, _, port = address.rpartition(":")
        try:
            # Without this check Ray waits for minutes for a cluster that is not there.
            socket.create_connection((host, int(port)), _CONNECT_SECONDS).close()
            ray.init(address, log_to_driver=False, logging_level="ERROR")
        except (OSError, ValueError, OverflowError, RuntimeError) as error:
            raise EgpError(
                f"no Ray cluster at {address!r} ({error}): give the HOST:PORT that "
                "`ray start --head` printed, or leave out --cluster to work on this machine alone"
            ) from error
        self.lost = (
            ray.exceptions.WorkerCrashedError,
            ray.exceptions.OutOfMemoryError,
            ray.exceptions.NodeDiedError,
            ray.exceptions.ObjectLostError,
        )
        """Errors of work whose process or machine was lost."""
        self._disconnect = ray.shutdown
        self._call = ray.remote(_call)

    def submit(
        self,
        work: Callable[Arguments, Result],
        /,
        *args: Arguments.args,
        **kwargs: Arguments.kwargs,
    ) -> Future[Result]:
        """Call `work` on the cluster."""
        future: Future[Result] = self._call.remote(work, args, kwargs).future()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:  # noqa: FBT001, FBT002
        """Disconnect, which also ends unfinished work."""
        del wait, cancel_futures
        self._disconnect()


def _call(
    work: Callable[..., Result], args: tuple[object, ...], kwargs: dict[str, object]
) -> Result:
    return work(*args, **kwargs)
