"""A service in its own process on this machine."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Self

from egp_service._core import EgpError
from egp_service.control.endpoints import free_endpoint, why_unreachable
from egp_service.control.service_child import FOLDER_PREFIX
from egp_service.control.toml_text import dumps

if TYPE_CHECKING:
    from collections.abc import Mapping

START_SECONDS = 20.0
DRAIN_SECONDS = 5.0


class ServiceStartError(EgpError):
    """The service did not start; the message ends with its last output."""


class ServiceProcess:
    """`egp serve` on a free loopback port; clients connect to `endpoint`.

    `stop` drains the service as SIGTERM does in production, `kill` simulates a failure,
    and `start` starts it again at the same endpoint. It also ends, and removes its files, if this
    process is killed.
    """

    def __init__(self, library: Path, settings: Mapping[str, object]) -> None:
        """Prepare to serve `library` with `settings` of the control step."""
        self.endpoint = free_endpoint()
        self._config = {
            "library": str(library.resolve()),
            "settings": settings,
            "zenoh": {"listen/endpoints": json.dumps([self.endpoint])},
        }
        self._cleanup = ExitStack()
        self._folder: Path | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the service and wait until it listens.

        Raises:
            ServiceStartError: if the service does not listen, or if another program listens at the
                endpoint.
            EgpError: if the service runs already, and outside a `with` block.

        """
        if self._folder is None:
            raise EgpError(
                "there is no folder for its files: start it within `with ServiceProcess(...):`"
            )
        if self._process is not None and self._process.poll() is None:
            raise EgpError("the service runs already: call `stop` or `kill` first")
        self._ended()
        if why_unreachable(self.endpoint) is None:
            raise ServiceStartError(
                f"the service did not start: another program listens at {self.endpoint}; make "
                "another `ServiceProcess`"
            )
        config, log_file = self._folder / "service.toml", self._folder / "log.txt"
        config.write_text(dumps(self._config), encoding="utf-8")
        child = "egp_service.control.service_child"
        command = [sys.executable, "-m", child, "serve", "--config", str(config)]
        with log_file.open("ab") as log:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=log, stderr=subprocess.STDOUT
            )
        deadline = time.monotonic() + START_SECONDS
        while (ended := self._process.poll() is not None) or why_unreachable(self.endpoint):
            if ended or time.monotonic() > deadline:
                self.kill()
                said = log_file.read_text(encoding="utf-8", errors="replace").strip()
                last = said[-2000:].removeprefix("egp: ") or (
                    f"it did not listen within {START_SECONDS:g} s, and said nothing; "
                    "see whether the machine is busy, and try again"
                )
                raise ServiceStartError(f"the service did not start: {last}")
            time.sleep(0.02)

    def stop(self) -> None:
        """Drain and end the service."""
        if self._process is None:
            return
        self._process.terminate()
        try:
            self._process.wait(DRAIN_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._ended()

    def kill(self) -> None:
        """End the service immediately."""
        if self._process is not None:
            self._process.kill()
            self._ended()

    def _ended(self) -> None:
        if self._process is not None:
            self._process.wait()
            if self._process.stdin is not None:
                self._process.stdin.close()
            self._process = None

    def __enter__(self) -> Self:
        """Start the service with its files in a temporary folder."""
        with ExitStack() as started:
            started.callback(setattr, self, "_folder", None)
            self._folder = Path(started.enter_context(TemporaryDirectory(prefix=FOLDER_PREFIX)))
            started.callback(self.stop)
            self.start()
            self._cleanup = started.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the service and remove its files."""
        self._cleanup.close()
