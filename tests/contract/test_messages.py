"""What the command line says about its own state: errors, warnings, waiting, interruptions."""

from __future__ import annotations

import subprocess
import sys
import time
import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

import pytest
import zenoh
from typer.testing import CliRunner

from egp_service import EgpError
from egp_service.cli import app, backends, output
from egp_service.cli.settings_file import naming, read_settings
from egp_service.control.client import LostTracesWarning
from egp_service.control.endpoints import free_endpoint
from egp_service.control.session import open_session, session_config, zenoh_reason
from egp_service.control.toml_text import dumps
from patience import PATIENCE

if TYPE_CHECKING:
    from pathlib import Path

EGP = [sys.executable, "-m", "egp_service"]


def failure(*arguments: str) -> str:
    result = CliRunner().invoke(app, list(arguments))
    assert isinstance(result.exception, EgpError), result.output
    return str(result.exception)


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("command", ["--help", "--version", "settings"])
def test_a_full_standard_output_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, unbuffered: str
) -> None:
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    with (tmp_path / "output").open("w") as written:
        done = subprocess.run(
            ["/bin/bash", "-c", 'ulimit -f 0; exec "$@"', "bash", *EGP, command],
            stdout=written,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=PATIENCE,
        )
    assert done.stderr == "egp: cannot write to the standard output: File too large\n"
    assert done.returncode == 1


def test_warnings_of_this_package_are_messages(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    others: list[str] = []
    with warnings.catch_warnings():
        monkeypatch.setattr(warnings, "showwarning", lambda text, *_: others.append(str(text)))
        output.show_own_warnings()
        warnings.simplefilter("always")
        warnings.warn("a.jsonl: 3 spans are lost", LostTracesWarning, stacklevel=1)
        assert capsys.readouterr().err == "egp: a.jsonl: 3 spans are lost\n"
        warnings.warn("of another package", UserWarning, stacklevel=1)
    assert others == ["of another package"]
    assert not capsys.readouterr().err


def held_up(*_: Any, **__: Any) -> int:  # noqa: ANN401 - as what it stands for
    time.sleep(1.5)
    return 0


def test_a_drive_and_a_fetch_say_what_they_wait_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint = free_endpoint()
    monkeypatch.setattr(backends, "CONNECT_SECONDS", 2.0)
    result = CliRunner().invoke(app, ["drive", "--connect", endpoint, "-o", str(tmp_path)])
    assert f"waiting up to 2 s for a service at {endpoint}" in result.output
    fetch = ["fetch", "0" * 64, "--connect", endpoint, "-o", str(tmp_path / "library")]
    result = CliRunner().invoke(app, [*fetch, "--timeout", "1.5"])
    assert f"waiting up to 1.5 s for a replica at {endpoint}" in result.output
    result = CliRunner().invoke(app, [*fetch, "--timeout", "0.5"])
    assert "waiting" not in result.output


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--connect", "CLOSED"], True),
        (["--connect=CLOSED", "--vehicles", "2"], True),
        (["--connect", "CLOSED", "--connect", "OPEN"], False),
        (["--zenoh", "zenoh.json5"], False),
    ],
)
def test_a_load_waits_only_where_nothing_listens(
    monkeypatch: pytest.MonkeyPatch, arguments: list[str], *, told: bool
) -> None:
    closed, opened = free_endpoint(), free_endpoint()
    monkeypatch.setattr("egp_service.cli.programs.run_program", held_up)
    stated = [a.replace("CLOSED", closed).replace("OPEN", opened) for a in arguments]
    with zenoh.open(session_config([], 1.0, {"listen/endpoints": [opened]})):
        result = CliRunner().invoke(app, ["load", *stated])
    assert result.exit_code == 0
    assert (f"waiting up to 10 s for a service at {closed}\n" in result.output) is told
    assert ("waiting" in result.output) is told


def test_an_interrupted_demo_names_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(import_module("egp_service.cli.demo"), "drive_laps", interrupted)
    result = CliRunner().invoke(app, ["demo", "-o", str(tmp_path)])
    (folder,) = tmp_path.iterdir()
    assert f"Interrupted. What was recorded until then is in {folder}\n" in result.output
    assert result.exit_code == 130


def test_errors_of_zenoh_have_no_places_in_its_source() -> None:
    text = "link failed at /root/.cargo/git/a-b/orchestrator.rs:447.; no route at /root/c/d.rs:9."
    assert zenoh_reason(zenoh.ZError(text)) == "link failed; no route"
    config = session_config([free_endpoint()], 0.2, {"mode": "client"})
    with pytest.raises(zenoh.ZError) as found:
        open_session(config, 0.2)
    assert ".rs:" in str(found.value)
    assert ".rs" not in zenoh_reason(found.value)
    assert len(zenoh_reason(found.value)) > 10


@pytest.mark.parametrize("folder", [".", "/", ""])
def test_a_folder_without_a_recording_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for command in (["replay"], ["load", "--replay"]):
        told = failure(*command, folder)
        assert f"got the folder {folder or '.'}, in which there is no run.mcap" in told


def test_a_folder_stands_for_its_recording(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_text("text")
    assert failure("replay", str(tmp_path)).startswith(f"{tmp_path / 'run.mcap'}: expected an MCAP")


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ({"lifetime": float("nan")}, "lifetime"),
        ({"cost": {"lateral": float("inf")}}, "cost.lateral"),
        ({"zones": [{"friction": [0.5, float("nan")]}]}, "zones.friction"),
        ({"cost": {"lateral": None}}, "cost.lateral"),
    ],
)
def test_a_value_without_a_form_in_toml_is_named(table: dict[str, object], key: str) -> None:
    with pytest.raises(EgpError, match=f"^{key}: expected "):
        dumps(table)


@pytest.mark.parametrize(
    "line",
    [
        "a" * 100_000 + " = 1",
        'cost = { lateral = "' + "a" * 100_000 + '" }',
        "cost = { lateral = 1, " + ", ".join(f"x{i} = {i}" for i in range(9000)) + " }",
    ],
)
def test_long_lines_of_a_file_are_cut_where_an_error_shows_them(tmp_path: Path, line: str) -> None:
    file = tmp_path / "long.toml"
    file.write_text(line)
    with pytest.raises(EgpError) as found:
        read_settings(file)
    told = str(found.value)
    assert f"\n1 | {line[:100]}" in told
    assert len(told) < 1000
    assert "expected" in told
    assert told.endswith("; `egp settings` lists all settings")
    wrapped = f"TOML parse error at line 1, column 1\n  |\n1 | {line}\n  | ^\nthis is wrong"
    with pytest.raises(EgpError) as found, naming(file):
        raise EgpError(wrapped)
    assert str(found.value) == f"{file}: this is wrong, in the line `{line[:120]}…`"
