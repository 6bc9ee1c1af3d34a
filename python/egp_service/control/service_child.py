"""The process of `ServiceProcess`: `egp serve`, which ends when the process that began it does.

Its standard input is a pipe that the other process holds open, and that the system closes when that
process ends in whatever way.
"""

from __future__ import annotations

import os
import runpy
import shutil
import signal
import sys
import threading
from pathlib import Path
from typing import Final

FOLDER_PREFIX: Final = "egp-service-"
"""The name of a service's folder begins with it; no other folder is removed."""


def main() -> None:
    """Run the command of the arguments, the last of which is a file in the service's folder."""
    folder = Path(sys.argv[-1]).parent
    alone = threading.Event()

    def wait() -> None:
        # A thread within a read of `sys.stdin` would hold a lock that the end of the process needs.
        while os.read(0, 1):
            pass
        alone.set()
        os.kill(os.getpid(), signal.SIGTERM)

    # Until the service has handlers of its own, for instance while it imports, SIGTERM would end
    # this process before its folder is removed.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        threading.Thread(target=wait, daemon=True).start()
        runpy.run_module("egp_service", run_name="__main__", alter_sys=True)
    finally:
        if alone.is_set() and folder.name.startswith(FOLDER_PREFIX):
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
