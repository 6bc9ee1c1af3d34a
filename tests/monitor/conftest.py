"""A monitor in a process of its own, and a browser if this machine has one."""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import socket
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

    from playwright.sync_api import Browser

CHROMIUM = next(
    (
        found
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (found := shutil.which(name))
    ),
    None,
)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


class MonitorProcess:
    """`egp monitor` with its page at `url`; vehicles publish to `listen`."""

    def __init__(self, connect: str) -> None:
        self.listen = f"tcp/127.0.0.1:{free_port()}"
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


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium found; on Debian `make browser` installs it")
    if importlib.util.find_spec("playwright") is None:
        pytest.skip("the package playwright is missing; `make lint` installs it")
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 - it may be missing

    # Chromium's sandbox does not start for root, as in most containers.
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        yield found
        found.close()
