"""Certificates in the zenoh configurations of vehicles and of the live page."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from security_programs import GATE, LIBRARY, secrets
from typer.testing import CliRunner

from egp_service import Controller, EgpError, FleetMap, StatusPublisher, VehicleClient
from egp_service._core import RoadBelief
from egp_service.cli import app
from egp_service.control.certificates import check_zenoh_file
from egp_service.control.endpoints import free_endpoint
from egp_service.control.network import ServiceUnreachableError
from road_evidence import PATH

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    Use = Callable[[str, Path, Mapping[str, object]], None]

EXPIRED = r"f@a\.json5, .*connect_certificate_base64: the certificate expired 0 days ago; renew"


def open_client(endpoint: str, file: Path, more: Mapping[str, object]) -> None:
    with pytest.raises(ServiceUnreachableError):
        VehicleClient.connect(
            endpoint, gate=GATE, timeout=0.1, zenoh_file=str(file), zenoh_config=more
        )


def open_map(endpoint: str, file: Path, more: Mapping[str, object]) -> None:
    with FleetMap(
        endpoint,
        RoadBelief(PATH),
        road="r",
        vehicle="a",
        timeout=0.1,
        zenoh_file=file,
        zenoh_config=more,
    ):
        pass


def open_status(endpoint: str, file: Path, more: Mapping[str, object]) -> None:
    with (
        Controller(LIBRARY, gate=GATE) as controller,
        StatusPublisher(controller, endpoint, zenoh_file=file, zenoh_config=more),
    ):
        pass


def renewed(folder: Path, days: int) -> Path:
    """Give the vehicle's file with a certificate that is valid for some days from now on."""
    own = secrets(folder, free_endpoint("tls"))
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    write_credentials(own, "f", ["a"], hosts=["127.0.0.1"], days=days)
    return own / "vehicles" / "f@a.json5"


def test_the_page_takes_the_files_of_monitor_and_operator_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = secrets(tmp_path / "own", free_endpoint("tls"))

    def opened(*_: object) -> None:
        raise EgpError("a session is opened")

    monkeypatch.setattr("egp_service.monitor.listener.Listener", opened)
    for name, expected in (
        ("vehicles/f@a.json5", r"f@a\.json5, .*the role vehicle, .*operator\.json5 of `egp keys`"),
        ("service.json5", r"the role service, .*operator\.json5"),
        ("monitor.json5", "a session is opened"),
        ("operator.json5", "a session is opened"),
    ):
        result = CliRunner().invoke(app, ["monitor", "--port", "0", "--zenoh", str(own / name)])
        with pytest.raises(EgpError, match=expected) as raised:
            raise result.exception or AssertionError
        notes = getattr(raised.value, "__notes__", [])
        assert any("or monitor.json5" in note for note in notes) is ("the role" in expected)


@pytest.mark.parametrize("use", [open_client, open_map, open_status])
def test_vehicles_check_their_certificates(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, use: Use
) -> None:
    endpoint = free_endpoint("tls")
    soon = renewed(tmp_path / "soon", 1)
    for _ in range(3):
        use(endpoint, soon, {})
    records = [one for one in caplog.records if "certificate" in one.getMessage()]
    # The number of days may change once meanwhile.
    assert len(records) in {1, 2}
    for record in records:
        assert record.levelno == logging.WARNING
        assert record.getMessage().startswith(f"zenoh file {soon}: a certificate expires in ")
    expired = renewed(tmp_path / "expired", 0)
    with pytest.raises(EgpError, match=EXPIRED):
        use(endpoint, expired, {})
    with pytest.raises(EgpError, match=r"the role operator, .*file vehicles/FLEET@VEHICLE\.json5"):
        use(endpoint, soon.parents[1] / "operator.json5", {})
    # The certificate of the file is not used.
    certificate = json.loads(soon.read_text())["transport"]["link"]["tls"]
    setting = "connect_certificate_base64"
    use(endpoint, expired, {f"transport/link/tls/{setting}": certificate[setting]})


def test_commands_check_the_certificates_of_a_vehicle(tmp_path: Path) -> None:
    file = str(renewed(tmp_path / "expired", 0))
    connect = ["--connect", free_endpoint("tls")]
    runs = tmp_path / "runs"
    drive = ["drive", "--vehicle", "f/a", "-o", str(runs), "--zenoh", file]
    for command in (
        [*drive, *connect],
        [*drive, "--fleet", free_endpoint("tls"), "--in-process"],
        [*drive, "--monitor", free_endpoint("tls"), "--in-process"],
        ["ros2", "--zenoh", file],
        ["ros2", *connect, "--service-zenoh", file],
    ):
        result = CliRunner().invoke(app, command)
        with pytest.raises(EgpError, match=EXPIRED):
            raise result.exception or AssertionError
    assert not runs.exists()


def test_a_command_warns_on_the_terminal(tmp_path: Path) -> None:
    file = secrets(tmp_path / "own", free_endpoint("tls")) / "monitor.json5"
    command = [sys.executable, "-m", "egp_service", "monitor", "--port", "0", "--zenoh", str(file)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert f"zenoh file {file}: a certificate expires in " in ended.stderr
    assert "zenoh cannot open a session" in ended.stderr  # no service runs


def test_other_configurations_of_zenoh_are_accepted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("cryptography", reason="the extra `security` is not installed")
    from egp_service.cli.certificates import Authority  # noqa: PLC0415

    authority = Authority.new(365)
    certificates = {
        "root_ca_certificate": authority.identity.certificate,
        "connect_certificate": authority.issue("car.example", 365).certificate,
    }
    for name, content in certificates.items():
        (tmp_path / name).write_bytes(content)
    tls = {name: str(tmp_path / name) for name in certificates}
    file = tmp_path / "own.json5"
    for settings in ({}, {"mode": "client"}, {"transport": {"link": {"tls": tls}}}):
        file.write_text(json.dumps(settings), encoding="utf-8")
        for role in ("vehicle", "operator"):
            check_zenoh_file(file, role=role)
    check_zenoh_file(None)
    check_zenoh_file(tmp_path / "missing.json5")
    assert not caplog.records
