"""The folder of `egp keys` when files were moved away from it, or a call was interrupted."""

from __future__ import annotations

import base64
import json
from typing import TYPE_CHECKING

import pytest
from security_programs import secrets, written

from egp_service import EgpError

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    "kept",
    [
        pytest.param({"ca.pem", "ca.key"}, id="authority"),
        pytest.param({"service.json5"}, id="service"),
        pytest.param({"vehicles/f@a.keys", "vehicles/f@a.json5"}, id="vehicle"),
    ],
)
def test_files_of_a_fleet_without_its_list_get_no_other_keys(
    tmp_path: Path, kept: set[str]
) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7447")
    whole = written(own)
    for name in set(whole) - kept:
        (own / name).unlink()
    with pytest.raises(EgpError, match=r"vehicles\.keys is missing, but .* is there.*restore it"):
        secrets(own, "tls/127.0.0.1:7447")
    assert written(own) == {name: whole[name] for name in kept}
    (own / "vehicles.keys").write_bytes(whole["vehicles.keys"])
    secrets(own, "tls/127.0.0.1:7447")
    after = written(own)
    assert set(after) == set(whole)
    for name in ("vehicles.keys", "vehicles/f@a.keys", "vehicles/f@b.keys"):
        assert after[name] == whole[name]


def test_a_new_authority_leaves_the_secret_keys(tmp_path: Path) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7447")
    before = written(own)
    for name in ("ca.pem", "ca.key"):
        (own / name).unlink()
    secrets(own, "tls/127.0.0.1:7447")
    after = written(own)
    same = {name for name in before if after[name] == before[name]}
    assert same == {
        "vehicles.keys", "vehicles/f@a.keys", "vehicles/f@b.keys", "library.key", "library.pub",
    }  # fmt: skip


def test_a_vehicle_is_removed_with_its_line(tmp_path: Path) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7447")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    ring = own / "vehicles.keys"
    first, _ = ring.read_text(encoding="utf-8").splitlines(keepends=True)
    ring.write_text(first, encoding="utf-8")
    assert write_credentials(own, "f", ["a"], hosts=["localhost"], days=1) == []
    assert ring.read_text(encoding="utf-8") == first
    permitted = (own / "service.json5").read_text(encoding="utf-8")
    assert "f/a" in permitted
    assert "f/b" not in permitted


def test_a_new_key_for_signatures_of_a_known_fleet_is_reported(tmp_path: Path) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7447")
    from egp_service.cli.credentials import write_credentials  # noqa: PLC0415

    told: list[str] = []
    for missing in ({"library.key"}, {"library.key", "library.pub"}):
        assert told == []
        before = (own / "library.pub").read_bytes()
        for name in missing:
            (own / name).unlink(missing_ok=True)
        write_credentials(own, "f", ["a"], hosts=["localhost"], days=1, report=told.append)
        same = (own / "library.pub").read_bytes() == before
        assert same == (missing == {"library.key"})
    assert "library.pub and " in told[0]
    assert "rejects all libraries" in told[0]


def test_a_first_call_that_was_interrupted_can_be_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    x509 = pytest.importorskip("cryptography.x509", reason="the extra `security` is not installed")
    from egp_service.cli import credentials  # noqa: PLC0415

    write, own, told = credentials._write, tmp_path / "own", list[str]()  # noqa: SLF001

    def call(may_write: int) -> list[str]:
        names: list[str] = []

        def interrupted(path: Path, text: str) -> None:
            if len(names) == may_write:
                raise KeyboardInterrupt
            write(path, text)
            names.append(path.name)

        monkeypatch.setattr(credentials, "_write", interrupted)
        credentials.write_credentials(
            own, "f", ["a"], hosts=["localhost"], days=1, report=told.append
        )
        return names

    names = call(20)
    for may_write in range(len(names)):
        own = tmp_path / str(may_write)
        with pytest.raises(KeyboardInterrupt):
            call(may_write)
        call(20)
        ring = (own / "vehicles.keys").read_text(encoding="utf-8")
        assert (own / "vehicles" / "f@a.keys").read_text(encoding="utf-8") == ring
        authority = x509.load_pem_x509_certificate((own / "ca.pem").read_bytes())
        for file in (own / "service.json5", own / "vehicles" / "f@a.json5"):
            tls = json.loads(file.read_text(encoding="utf-8"))["transport"]["link"]["tls"]
            certificate = base64.b64decode(tls["connect_certificate_base64"])
            x509.load_pem_x509_certificate(certificate).verify_directly_issued_by(authority)
    assert not any("another pair" in text for text in told)


@pytest.mark.parametrize("there", ["service.json5", "vehicles", "neither"])
def test_a_key_of_an_authority_that_may_have_signed_is_not_replaced(
    tmp_path: Path, there: str
) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7447")
    # What is left of a whole folder; with neither, the list of the vehicles is missing, too.
    kept = {"vehicles.keys", "ca.key", there} if there != "neither" else {"ca.key"}
    for file in sorted(own.rglob("*"), reverse=True):
        first = file.relative_to(own).parts[0]
        if first not in kept:
            file.rmdir() if file.is_dir() else file.unlink()
    before = written(own)
    with pytest.raises(EgpError, match=r"ca\.pem is missing: copy the authority's certificate"):
        secrets(own, "tls/127.0.0.1:7447")
    assert written(own) == before
