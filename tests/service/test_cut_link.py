"""A vehicle that the network cuts off gets its commands in time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[1] / "bench" / "cut_link.py"
SKIPPED = 77


def test_a_full_link_delays_no_command() -> None:
    """Requests that a link has no room for are dropped; zenoh would wait for room."""
    done = subprocess.run([sys.executable, PROGRAM], capture_output=True, text=True, check=False)
    if done.returncode == SKIPPED:
        pytest.skip(done.stdout.strip())
    assert done.returncode == 0, done.stdout + done.stderr
