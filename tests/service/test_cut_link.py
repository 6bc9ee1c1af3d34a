"""A vehicle that the network cuts off gets its commands in time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from patience import ATTEMPTS

PROGRAM = Path(__file__).parents[1] / "bench" / "cut_link.py"
SKIPPED = 77


def test_a_full_link_delays_no_command() -> None:
    """Requests that a link has no room for are dropped; zenoh would wait for room.

    It would do so each time, and a stall of the machine does not come each time.
    """
    command = [sys.executable, str(PROGRAM)]
    for _ in range(ATTEMPTS):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == SKIPPED:
            pytest.skip(done.stdout.strip())
        if done.returncode == 0:
            return
    raise AssertionError(done.stdout + done.stderr)
