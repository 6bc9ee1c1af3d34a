"""Endpoints and credentials of the tests of security."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path


def free_endpoint(protocol: str = "tcp") -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"{protocol}/127.0.0.1:{probe.getsockname()[1]}"


def secrets(folder: Path, endpoint: str) -> Path:
    """Write the files of `egp keys` for the vehicles a and b of the fleet f."""
    pytest.importorskip("cryptography", reason="the extra `security` is not installed")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    port = int(endpoint.rpartition(":")[2])
    write_credentials(folder, "f", ["a", "b"], hosts=["127.0.0.1"], port=port, days=1)
    return folder
