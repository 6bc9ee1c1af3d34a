"""Stops processes as a machine does that hangs."""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import subprocess


def freeze(process: subprocess.Popen[str] | subprocess.Popen[bytes]) -> None:
    """Stop a child process, and return once none of its threads runs any more.

    A signal only asks for it: on a busy machine a thread may still answer a request before the
    process has stopped.
    """
    process.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
