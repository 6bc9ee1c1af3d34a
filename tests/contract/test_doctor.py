"""What `egp doctor` finds on machines that are not fit."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from typer.main import get_command

from egp_service.cli import app
from egp_service.cli.checks import PAGE
from egp_service.control.endpoints import free_endpoint

if TYPE_CHECKING:
    from click import Group

DOCTOR = (sys.executable, "-m", "egp_service", "doctor")


def test_the_affinity_bounds_the_cores() -> None:
    pinned = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "from egp_service.cli import main; main()"
    )
    command = [sys.executable, "-c", pinned, "doctor"]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "1 core for this process" in " ".join(told.stdout.split())


def test_the_page_of_the_monitor_is_checked_where_it_is() -> None:
    group: Group = get_command(app)  # type: ignore[assignment]
    defaults = {each.name: each.default for each in group.commands["monitor"].params}
    assert f"tcp/{defaults['host']}:{defaults['port']}" == PAGE


def test_a_session_without_a_loopback_interface_is_a_failure() -> None:
    alone = ["unshare", "--user", "--map-root-user", "--net"]
    if shutil.which("unshare") is None or subprocess.run([*alone, "true"], check=False).returncode:
        pytest.skip("no namespaces of networks here")
    told = subprocess.run([*alone, *DOCTOR], capture_output=True, text=True, check=False)
    assert told.returncode == 1
    assert re.search(r"zenoh .*cannot", told.stdout)
    assert "loopback" in told.stdout


def test_an_encoding_without_arrows_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """The advice about a port in use has an arrow before it."""
    monkeypatch.setenv("PYTHONIOENCODING", "latin-1")
    program = (
        "from egp_service.cli import checks, main\n"
        f"checks.PORTS['egp serve'] = 'tcp/192.0.2.1:{free_endpoint().rpartition(':')[2]}'\n"
        "main()"
    )
    command = [sys.executable, "-c", program, "doctor"]
    told = subprocess.run(command, capture_output=True, check=False)
    assert told.stderr == b""
    assert b"? fine if" in told.stdout
