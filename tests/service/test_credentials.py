"""The files of `egp keys` when it is called again, and what it does not accept."""

from __future__ import annotations

import json
import os
import re
import ssl
import subprocess
import sys
from base64 import b64decode
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import pytest
from security_programs import secrets, written
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service.cli import app
from egp_service.shipped import DEMO_LIBRARY

if TYPE_CHECKING:
    from pathlib import Path


def lifetime(file: Path, end: str = "connect") -> timedelta:
    """Return for how long the certificate of a configuration is still valid."""
    from cryptography import x509  # noqa: PLC0415

    tls = json.loads(file.read_text())["transport"]["link"]["tls"]
    certificate = x509.load_pem_x509_certificate(b64decode(tls[f"{end}_certificate_base64"]))
    return certificate.not_valid_after_utc - datetime.now(UTC)


def endpoints(file: Path, direction: str = "connect") -> list[str]:
    """Return the endpoints of a configuration."""
    found: list[str] = json.loads(file.read_text())[direction]["endpoints"]
    return found


def test_a_vehicle_is_renewed_with_its_key_and_endpoints(tmp_path: Path) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7447")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    before = written(own)
    told: list[str] = []

    def renew(days: int, host: str = "other.example") -> None:
        new = write_credentials(own, "f", ["a"], hosts=[host], days=days, report=told.append)
        assert new == []

    renew(5)
    after = written(own)
    changed = {name for name in before if after[name] != before[name]}
    configurations = {
        f"{name}.json5" for name in ("service", "map", "router", "operator", "monitor")
    }
    assert changed == {"vehicles/f@a.json5", *configurations}
    file = own / "vehicles" / "f@a.json5"
    assert lifetime(file) > timedelta(days=4.9)
    assert endpoints(file) == ["tls/127.0.0.1:7447"]
    assert told == []
    # The authority of a first call with days=1 is valid for 10 days.
    renew(20)
    for end, name in (("connect", file), ("listen", own / "service.json5")):
        assert timedelta(days=9.9) < lifetime(name, end) < timedelta(days=10)
    assert len(told) == 1
    assert "expire with the authority" in told[0]
    # Without its file a vehicle gets the endpoints of the call.
    file.unlink()
    renew(1)
    assert endpoints(file) == ["tls/other.example:7447"]
    assert "f@a.json5 is not there" in told[1]
    # So does a vehicle that was removed and is new again.
    (own / "vehicles.keys").write_bytes(b"")
    write_credentials(own, "f", ["b"], hosts=["other.example"], days=1)
    assert endpoints(own / "vehicles" / "f@b.json5") == ["tls/other.example:7447"]


def test_without_the_list_of_vehicles_no_key_is_replaced(tmp_path: Path) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7447")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    ring = own / "vehicles.keys"
    whole = ring.read_bytes()
    ring.unlink()
    before = written(own)
    with pytest.raises(EgpError, match=r"vehicles.keys is missing.*restore it"):
        write_credentials(own, "f", ["a", "c"], hosts=["localhost"], days=1)
    assert written(own) == before
    # The list is restored as the error says.
    ring.write_bytes(b"".join(f.read_bytes() for f in sorted((own / "vehicles").glob("*.keys"))))
    assert ring.read_bytes() == whole
    assert write_credentials(own, "f", ["a", "c"], hosts=["localhost"], days=1) == ["f/c"]
    assert ring.read_bytes().startswith(whole)


@pytest.mark.parametrize("name", ["service", "map", "operator"])
def test_a_router_does_not_take_the_file_of_another_program(tmp_path: Path, name: str) -> None:
    from egp_service.control.router import Router  # noqa: PLC0415

    own = secrets(tmp_path / "own", "tls/127.0.0.1:7447")
    with pytest.raises(EgpError, match=rf"{name}.json5 has the mode 'peer'.*state router.json5"):
        Router([], (), str(own / f"{name}.json5"))


def test_calls_at_the_same_time_complete_one_folder(tmp_path: Path) -> None:
    own, names = tmp_path / "own", ["a", "b", "c", "d"]
    command = [sys.executable, "-m", "egp_service", "keys", str(own), "--host", "localhost"]
    calls = [
        subprocess.Popen([*command, "--vehicle", name], stdout=subprocess.DEVNULL) for name in names
    ]
    assert [call.wait(60.0) for call in calls] == [0, 0, 0, 0]
    ring = (own / "vehicles.keys").read_text(encoding="utf-8")
    assert re.findall(r"^default/(\w) ", ring, re.MULTILINE) == names
    files = [own / "vehicles" / f"default@{name}.json5" for name in names]
    tls = [json.loads(file.read_text())["transport"]["link"]["tls"] for file in files]
    assert len({one["root_ca_certificate_base64"] for one in tls}) == 1


def test_only_the_owner_can_look_into_the_folders(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        own = secrets(tmp_path / "new" / "own", "tls/127.0.0.1:7447")
    finally:
        os.umask(before)
    modes = {path: path.stat().st_mode & 0o777 for path in (own, *own.rglob("*"))}
    assert all(mode == (0o700 if path.is_dir() else 0o600) for path, mode in modes.items()), modes
    assert modes[own / "vehicles"] == 0o700


def test_a_further_vehicle_moves_no_endpoint_unless_it_is_said(tmp_path: Path) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7460")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    router = own / "router.json5"
    router.write_text(router.read_text().replace("tls/[::]:7449", "tls/10.0.0.5:7470"))
    told: list[str] = []
    for vehicle, port in (("c", None), ("d", 7460), ("e", 7480)):
        assert told == []
        write_credentials(
            own, "f", [vehicle], hosts=["other.example"], port=port, days=1, report=told.append
        )
        assert endpoints(own / "vehicles" / f"f@{vehicle}.json5") == [
            f"tls/other.example:{port or 7460}"
        ]
        for file, listening in (
            (own / "service.json5", f"tls/[::]:{port or 7460}"),
            (own / "map.json5", "tls/[::]:7448"),
            (router, "tls/10.0.0.5:7470"),
        ):
            expected = f"{listening}#tls_handshake_timeout_ms=2000"
            assert endpoints(file, "listen") == [expected]
        for name in ("operator", "monitor"):
            assert endpoints(own / f"{name}.json5") == ["tls/127.0.0.1:7460"]
    assert "service.json5 listens on port 7480 from now on, in place of 7460" in told[0]


def test_an_expired_authority_makes_no_certificates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7447")
    from egp_service.cli import certificates  # noqa: PLC0415

    # Made eleven days ago, for ten days.
    monkeypatch.setattr(
        certificates, "_after", lambda days: datetime.now(UTC) + timedelta(days=days - 11)
    )
    monkeypatch.setattr(certificates, "_CLOCK_DIFFERENCE", timedelta(days=12))
    for name in ("ca.pem", "ca.key"):
        (own / name).unlink()
    old = secrets(own, "tls/127.0.0.1:7447")
    before = written(old)
    with pytest.raises(EgpError, match=r"ca\.pem: the authority expired on .*move ca\.pem"):
        secrets(old, "tls/127.0.0.1:7447")
    assert written(old) == before
    monkeypatch.undo()
    for name in ("ca.pem", "ca.key"):
        (own / name).unlink()
    secrets(own, "tls/127.0.0.1:7447")
    assert lifetime(own / "vehicles" / "f@a.json5") > timedelta(hours=23)


def test_a_private_key_is_never_replaced(tmp_path: Path) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7447")
    before = written(own)
    (own / "library.pub").unlink()
    secrets(own, "tls/127.0.0.1:7447")
    for name in ("library.key", "library.pub", "ca.key"):
        assert (own / name).read_bytes() == before[name]


@pytest.mark.parametrize(
    ("fleet", "host", "complaint"),
    [
        ("f", "b\u00fccher.example", "begins with xn--"),
        ("f", "control.example:7447", "--port gives the port"),
        ("f", "", "expected an IPv4 address"),
        ("f", "http://x", "expected an IPv4 address"),
        ("f", "fd00::2", "a host name that resolves to it"),
        ("f", "a" * 64, "parts between dots have 1 to 63 letters"),
        ("f", "control." + "a" * 300, "parts between dots have 1 to 63 letters"),
        ("f", "-x", "without a hyphen at either end"),
        ("f", "control-.example", "without a hyphen at either end"),
        ("f", "control..example", "parts between dots have 1 to 63 letters"),
        ("f", ".".join(["a" * 63] * 4), "at most 253 characters"),
        ("library", "control.example", "choose another --fleet"),
    ],
)
def test_what_no_certificate_can_name_is_an_error_before_anything_is_written(
    tmp_path: Path, fleet: str, host: str, complaint: str
) -> None:
    pytest.importorskip("cryptography", reason="the extra `security` is not installed")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    with pytest.raises(EgpError, match=complaint):
        write_credentials(tmp_path / "own", fleet, ["a"], hosts=["h", host], port=1, days=1)
    assert not (tmp_path / "own").exists()
    longest = ".".join([*["a" * 63] * 3, "a" * 61])
    for good in ("10.0.0.5", "control-1.example", "a" * 63, "x", longest):
        write_credentials(tmp_path / "own", "f", ["library"], hosts=[good], port=1, days=1)


@pytest.mark.parametrize("line", ["f/b", "f/b 5e5e", "b " + "5e" * 32])
def test_a_line_without_a_key_is_named_before_anything_is_written(
    tmp_path: Path, line: str
) -> None:
    pytest.importorskip("cryptography", reason="the extra `security` is not installed")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    (tmp_path / "vehicles.keys").write_text(f"# ours\nf/a {'77' * 32}\n\n{line}\n")
    with pytest.raises(EgpError, match=r"vehicles\.keys, line 4: expected FLEET/VEHICLE and a key"):
        write_credentials(tmp_path, "f", ["c"], hosts=["h"], port=1, days=1)
    assert [path.name for path in tmp_path.iterdir()] == ["vehicles.keys"]


def test_a_vehicle_with_two_keys_and_a_damaged_authority_are_errors(tmp_path: Path) -> None:
    pytest.importorskip("cryptography", reason="the extra `security` is not installed")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    def write() -> None:
        write_credentials(tmp_path, "f", ["c"], hosts=["h"], port=1, days=1)

    (tmp_path / "vehicles.keys").write_text(f"f/a {'77' * 32}\nf/a {'78' * 32}\n")
    with pytest.raises(EgpError, match=r"vehicles\.keys, line 2: f/a has a key already"):
        write()
    (tmp_path / "vehicles.keys").unlink()
    write()
    for name in ("ca.pem", "ca.key"):
        file = tmp_path / name
        before = file.read_bytes()
        file.write_bytes(before[:100])
        with pytest.raises(EgpError, match="is not as `egp keys` wrote it"):
            write()
        file.write_bytes(before)
    authority = tmp_path / "ca.pem"
    before = authority.read_bytes()
    version = b"\xa0\x03\x02\x01"  # of X.509
    der = ssl.PEM_cert_to_DER_cert(before.decode()).replace(version + b"\2", version + b"\7", 1)
    authority.write_text(ssl.DER_cert_to_PEM_cert(der))
    with pytest.raises(EgpError, match=r"is not as `egp keys` wrote it \(7 is not a valid"):
        write()
    authority.write_bytes(before)
    service = tmp_path / "service.json5"
    config = json.loads(service.read_text())
    operator = json.loads((tmp_path / "operator.json5").read_text())
    tls = operator["transport"]["link"]["tls"]
    without_hosts = {"listen_certificate_base64": tls["connect_certificate_base64"]}
    config["transport"]["link"]["tls"] |= without_hosts
    kept = service.read_bytes()
    service.write_text(json.dumps(config))
    with pytest.raises(EgpError, match=r"service\.json5 is not as `egp keys` wrote it"):
        write()
    service.write_bytes(kept)
    write()


@pytest.mark.parametrize(("days", "warned"), [(10, True), (60, False)])
def test_a_check_warns_of_a_certificate_that_expires_soon(
    tmp_path: Path, days: int, *, warned: bool
) -> None:
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    write_credentials(tmp_path, "f", ["a"], hosts=["127.0.0.1"], port=7447, days=days)
    config = tmp_path / "service.toml"
    lines = (
        f"library = '{DEMO_LIBRARY}'",
        f"zenoh_file = '{tmp_path / 'service.json5'}'",
        f"vehicle_keys = '{tmp_path / 'vehicles.keys'}'",
    )
    config.write_text("\n".join(lines), encoding="utf-8")
    result = CliRunner().invoke(app, ["serve", "--config", str(config), "--check"])
    assert result.exit_code == 0, result.output
    # Ten whole days are left in the second in which the certificate was made.
    warning = r"a certificate expires in (9|10) days; renew it with `egp keys`"
    assert bool(re.search(warning, result.output)) == warned
    assert "valid" in result.output
    # The file of another role is an error.
    text = config.read_text(encoding="utf-8").replace("service.json5", "map.json5")
    config.write_text(text, encoding="utf-8")
    result = CliRunner().invoke(app, ["serve", "--config", str(config), "--check"])
    assert "map.json5" in str(result.exception)
    assert "state the file service.json5" in str(result.exception)
