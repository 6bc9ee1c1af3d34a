"""Certificates of other roles, and files of an operator that are no regular files."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest
from security_programs import secrets
from typer.testing import CliRunner

from egp_service import EgpError, shipped
from egp_service._core import check_certificates
from egp_service.cli import app
from egp_service.control.endpoints import free_endpoint

if TYPE_CHECKING:
    from pathlib import Path


def test_a_certificate_is_checked_for_a_role(tmp_path: Path) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7460")
    warning = check_certificates(own / "router.json5", "router")
    assert warning is not None
    assert "expires in" in warning
    with pytest.raises(EgpError, match=r"service\.json5, .*the role service, .*the role router"):
        check_certificates(own / "service.json5", "router")
    # A vehicle does not listen, so that its certificate is one of any name.
    assert check_certificates(own / "vehicles" / "f@a.json5", "vehicle") is not None
    routed = CliRunner().invoke(app, ["router", "--zenoh", str(own / "map.json5")])
    assert isinstance(routed.exception, EgpError)
    assert "the role map" in str(routed.exception)


def test_a_device_is_not_replaced_by_a_library(tmp_path: Path) -> None:
    pipe = tmp_path / "library.safetensors"
    os.mkfifo(pipe)
    command = ["fetch", "ab" * 32, "-o", str(pipe), "--connect", free_endpoint()]
    begun = time.monotonic()
    result = CliRunner().invoke(app, [*command, "--timeout", "60"])
    assert isinstance(result.exception, EgpError)
    assert "expected a regular file or a new name" in str(result.exception)
    assert time.monotonic() - begun < 30.0
    assert pipe.is_fifo()


def test_keys_in_a_pipe_do_not_hold_a_service_up(tmp_path: Path) -> None:
    pipe, config = tmp_path / "vehicles.keys", tmp_path / "service.toml"
    os.mkfifo(pipe)
    library = f'library = "{shipped.DEMO_LIBRARY}"\n'
    config.write_text(f'{library}vehicle_keys = "{pipe}"\n', encoding="utf-8")
    serve = [sys.executable, "-m", "egp_service", "serve", "--config", str(config)]
    serve += ["--listen", free_endpoint()]
    ended = subprocess.run(serve, capture_output=True, text=True, check=False, timeout=60)
    assert ended.returncode == 1
    assert "vehicles.keys: expected a regular file" in ended.stderr
