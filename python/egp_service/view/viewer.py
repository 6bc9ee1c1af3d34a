"""Files of Rerun, and its viewer in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import rerun as rr
import rerun_cli

from egp_service._core import EgpError
from egp_service.files import replacing
from egp_service.view.entities import log_run
from egp_service.view.layout import layout

if TYPE_CHECKING:
    from egp_service.view.run import RecordedRun

QUIET: Final = {"CI": "1", "ALL_PROXY": "http://127.0.0.1:9"}
"""With `CI` the viewer sends no usage data. It has no option against asking GitHub whether there is
a newer version; behind a proxy on a port where nothing listens, the question stays on this machine.
"""
_DISPLAYS: Final = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
"""Variables of the environment, one of which names the display on Linux."""
_WITHOUT_DISPLAY: Final = (
    "without a display, write a file with --save FILE.rrd and open it with `rerun FILE.rrd` on "
    "another machine"
)
_ARGUMENTS: Final = ("--new", "--bind=127.0.0.1", "--hide-welcome-screen")


def save(run: RecordedRun, name: str, path: Path) -> None:
    """Write a run as a file of Rerun with its layout; the viewer shows it by that name.

    Raises:
        EgpError: if the path is a folder, or does not end in `.rrd`, by which Rerun recognises its
            files.
        OSError: if the file cannot be written.

    """
    if path.is_dir():
        raise EgpError(f"{path} is a folder: name a file in it, such as {path / 'run.rrd'}")
    if path.suffix != ".rrd":
        raise EgpError(f"expected a file name that ends in .rrd, got {path}: try {path.stem}.rrd")
    rr.set_strict_mode(True)
    with replacing(path) as beside:
        recording = rr.RecordingStream("egp_view", send_properties=False)
        written = recording.memory_recording()
        recording.send_blueprint(layout(run), make_active=False)
        recording.send_recording_name(name)
        log_run(recording, run)
        # Rerun reports no error if a full disk cuts off a file that it writes itself.
        beside.write_bytes(written.drain_as_bytes())
        recording.disconnect()


def show(path: Path) -> None:
    """Show a file of Rerun in a viewer of its own until the window is closed.

    Only this machine reaches the viewer's port.

    Raises:
        EgpError: if the viewer fails, for instance because there is no display.

    """
    if sys.platform == "linux" and not any(map(os.environ.get, _DISPLAYS)):
        raise EgpError(
            "there is no display for the viewer's window: none of the variables "
            f"{', '.join(_DISPLAYS)} is set; {_WITHOUT_DISPLAY}"
        )
    program = Path(rerun_cli.__file__).with_name("rerun")
    environment = {"RUST_LOG": "error"} | os.environ | QUIET
    code = subprocess.run([program, path, *_ARGUMENTS], env=environment, check=False).returncode
    if code != 0:
        raise EgpError(f"the viewer of Rerun ended with status {code}; {_WITHOUT_DISPLAY}")
