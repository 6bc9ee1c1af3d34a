"""What `egp doctor` finds on machines that are not fit."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from typer.main import get_command

from egp_service.cli import app
from egp_service.cli.checks import PAGE, available_cores, run_checks
from egp_service.control.endpoints import free_endpoint

if TYPE_CHECKING:
    from pathlib import Path

    from click import Group

DOCTOR = (sys.executable, "-m", "egp_service", "doctor")


def groups(root: Path, text: str, files: dict[str, str]) -> Path:
    """Write the group of the process and files below the folder of all groups."""
    for name, value in {"proc/self/cgroup": text, **files}.items():
        file = root / ("" if name.startswith("proc") else "sys/fs/cgroup") / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"{value}\n", encoding="utf-8")
    return root


def test_quotas_of_groups_bound_the_cores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))
    assert available_cores(tmp_path) == 8
    old = {"cpu,cpuacct/cpu.cfs_quota_us": "290000", "cpu,cpuacct/cpu.cfs_period_us": "100000"}
    outside = "/docker/0123"  # the path on the machine, which a container does not see
    for number, (text, files, cores) in enumerate(
        (
            ("0::/", {"cpu.max": "250000 100000"}, 2),
            ("0::/", {"cpu.max": "max 100000"}, 8),
            ("0::/", {"cpu.max": "50000 100000"}, 1),
            ("0::/a/b", {"a/b/cpu.max": "max 100000", "a/cpu.max": "300000 100000"}, 3),
            (f"3:cpuset:/\n2:cpu,cpuacct:{outside}\n0::/", old, 2),
            ("1:cpu:/", {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"}, 8),
        )
    ):
        assert available_cores(groups(tmp_path / str(number), text, files)) == cores, files


def test_the_page_of_the_monitor_is_checked_where_it_is() -> None:
    group: Group = get_command(app)  # type: ignore[assignment]
    defaults = {each.name: each.default for each in group.commands["monitor"].params}
    assert f"tcp/{defaults['host']}:{defaults['port']}" == PAGE


def test_a_session_that_nobody_reaches_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    checked = "egp_service.cli.checks.why_unreachable"
    monkeypatch.setattr(checked, lambda _: "Network is unreachable")
    (zenoh,) = (check for check in run_checks() if check.name == "zenoh")
    assert zenoh.verdict == "fail"
    assert "Network is unreachable" in zenoh.found
    assert "loopback" in zenoh.advice


def test_the_failure_is_found_without_a_loopback_interface() -> None:
    alone = ["unshare", "--user", "--map-root-user", "--net"]
    if shutil.which("unshare") is None or subprocess.run([*alone, "true"], check=False).returncode:
        pytest.skip("no namespaces of networks here")
    told = subprocess.run([*alone, *DOCTOR], capture_output=True, text=True, check=False)
    assert told.returncode == 1
    assert "cannot" in told.stdout


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
