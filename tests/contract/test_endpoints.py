"""Endpoints of another form are errors with one that was probably meant."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from egp_service import InvalidArgumentError
from egp_service.cli import app
from egp_service.control.endpoints import check_endpoints

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("endpoint", "meant"),
    [
        ("7447", "tcp/127.0.0.1:7447"),
        ("localhost", "tcp/localhost:7447"),
        ("10.0.0.5:7460", "tcp/10.0.0.5:7460"),
        (":7460", "tcp/127.0.0.1:7460"),
        ("", "tcp/127.0.0.1:7447"),
        ("99999", "tcp/127.0.0.1:7447"),
        ("http://10.0.0.5:7447/", "tcp/10.0.0.5:7447"),
        ("TLS/car.example:7447", "tls/car.example:7447"),
        ("tcp/7447", "tcp/127.0.0.1:7447"),
        ("tls/", "tls/127.0.0.1:7447"),
        ("tls/car.example", "tls/car.example:7447"),
        ("tcp/:7460", "tcp/127.0.0.1:7460"),
        ("tcp/localhost:http", "tcp/localhost:7447"),
        ("::1", "tcp/[::1]:7447"),
        ("tcp/[::1]", "tcp/[::1]:7447"),
        ("[::1]:7460", "tcp/[::1]:7460"),
        ("[", "tcp/127.0.0.1:7447"),
    ],
)
def test_an_endpoint_of_another_form_is_completed(endpoint: str, meant: str) -> None:
    with pytest.raises(InvalidArgumentError, match="did you mean") as found:
        check_endpoints([endpoint])
    assert str(found.value).startswith(f"endpoint {endpoint!r}: expected ")
    assert str(found.value).endswith(f"did you mean {meant!r}?")
    check_endpoints([meant])


def test_a_port_is_a_number_of_16_bits() -> None:
    check_endpoints(["tcp/127.0.0.1:0", "udp/a:65535", "tls/[::1]:7447#iface=lo"])
    with pytest.raises(InvalidArgumentError, match="a port of at most 65535"):
        check_endpoints(["tcp/localhost:65536"])


def test_other_protocols_have_other_addresses() -> None:
    check_endpoints(["unixsock-stream//tmp/socket", "serial//dev/ttyUSB0#baudrate=9600"])


@pytest.mark.parametrize(
    ("command", "meant"),
    [
        ("map --listen xyz", "tcp/xyz:7448"),
        ("monitor --listen xyz", "tcp/xyz:7450"),
        ("router --listen xyz", "tcp/xyz:7449"),
        ("serve nothing --listen xyz", "tcp/xyz:7447"),
        ("drive -s random --in-process --no-pictures --fleet xyz --vehicle v", "tcp/xyz:7448"),
        ("drive -s random --in-process --no-pictures --monitor xyz", "tcp/xyz:7450"),
    ],
)
def test_the_suggested_port_is_that_of_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, meant: str
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, command.split())
    assert f"did you mean {meant!r}?" in str(result.exception)
