"""A monitor in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

from egp_service.control.endpoints import free_endpoint, free_port


class MonitorProcess:
    """`egp monitor` with its page at `url`; vehicles publish to `listen`."""

    def __init__(self, connect: str) -> None:
        self.listen = free_endpoint()
        self._port = free_port()
        self.url = f"http://127.0.0.1:{self._port}"
        self._connect = connect
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Start the process and wait until it serves the page."""
        self._process = subprocess.Popen(
            [
                sys.executable, "-m", "egp_service", "monitor", "--connect", self._connect,
                "--listen", self.listen, "--port", str(self._port),
            ],
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )  # fmt: skip
        assert self._process.stdout is not None
        assert self._process.stdout.readline().startswith(f"Live page: {self.url}")

    def end(self, number: int = signal.SIGTERM) -> int:
        """End the process by a signal; return its exit code."""
        assert self._process is not None
        self._process.send_signal(number)
        code = self._process.wait(10)
        assert self._process.stdout is not None
        self._process.stdout.close()
        return code
