"""Commands that explain: versions, settings, the state of the machine, and errors that help."""

from __future__ import annotations

import os
import re
import socket
import tomllib
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from typer.main import get_command
from typer.testing import CliRunner

from egp_service import Controller, EgpError, Library, Plant, shipped
from egp_service import Path as Road
from egp_service._core import SETTINGS_DOCUMENT
from egp_service.cli import app
from egp_service.cli.checks import run_checks
from egp_service.cli.settings_text import read_settings_document
from egp_service.control.endpoints import check_endpoints, why_not_free, why_unreachable
from egp_service.control.recorded import Recorded, RecordedStep, write_requests
from egp_service.data.dataset import Dataset
from egp_service.data.provenance import Provenance
from egp_service.files import replacing, write_text

if TYPE_CHECKING:
    from click import Group

RUNNER = CliRunner()
LIBRARY = str(shipped.DEMO_LIBRARY)
DOCUMENT = Path(__file__).parents[2] / "docs/settings.md"


def failure(*arguments: str) -> str:
    """Run a command that must fail with an `EgpError`, and return its message."""
    result = RUNNER.invoke(app, arguments)
    assert isinstance(result.exception, EgpError), result.output
    return str(result.exception)


def commands() -> list[str]:
    """Return the names of all commands, those of a group behind its name."""
    group: Group = get_command(app)  # type: ignore[assignment]
    names = []
    for name, command in group.commands.items():
        names.append(name)
        names += [f"{name} {inner}" for inner in getattr(command, "commands", ())]
    return sorted(names)


@pytest.mark.parametrize("name", commands())
def test_help_fits_80_columns_and_has_an_example(name: str) -> None:
    text = RUNNER.invoke(app, [*name.split(), "--help"], env={"COLUMNS": "80"}).output
    assert max(len(line) for line in text.splitlines()) <= 80
    # The line of the usage begins with another word.
    assert re.search(rf"(?m)^ +(For example: )?egp {name}\b", text)
    # No line of the description is so long that its last word has a line of its own.
    group = get_command(app)
    for part in name.split():
        group = group.commands[part]  # type: ignore[attr-defined]
    assert [line for line in (group.help or "").split("\n")[1:] if len(line) > 78] == []
    # Nothing of it is lost as markup, which text in brackets would be.
    assert " ".join((group.help or "").split()) in " ".join(text.split())


def test_version_and_completion() -> None:
    assert re.fullmatch(r"egp-service \d+\.\d+\.\d+\n", RUNNER.invoke(app, ["--version"]).output)
    assert "--install-completion" in RUNNER.invoke(app, ["--help"]).output


def test_settings_are_those_of_the_document() -> None:
    assert DOCUMENT.read_text(encoding="utf-8") == SETTINGS_DOCUMENT
    listed = list(read_settings_document())
    rows = re.findall(r"^\| `", SETTINGS_DOCUMENT, re.MULTILINE)
    assert len(listed) == len(rows)
    assert not [s for s in listed if re.search(r"[$`\\]", s.default + s.unit + s.meaning)]
    lateral = next(setting for setting in listed if setting.key == "cost.lateral")
    assert (lateral.section, lateral.default, lateral.unit) == ("Control step", "80.0", "1/m²")
    shown = RUNNER.invoke(app, ["settings", "cost", "lateral"], env={"COLUMNS": "80"}).output
    assert "cost.lateral" in shown
    assert "cost.v_x" not in shown
    assert "no setting has 'nonsense'" in failure("settings", "nonsense")


def test_evaluate_is_full_or_quick() -> None:
    assert "--full and --quick exclude each other" in failure("evaluate", "--full", "--quick")
    told = failure("evaluate", "--log", "a.parquet", "--full", "-e", "prediction")
    assert "--full, --experiment cannot be used with --log" in told
    assert RUNNER.invoke(app, ["evaluate", "--jobs", "-3"]).exit_code == 2


def test_what_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError, match="this is a folder; name a file in it") as found:
        write_text(tmp_path, "")
    assert found.value.filename == str(tmp_path)
    with pytest.raises(FileNotFoundError) as lost, replacing(tmp_path / "a.txt"):
        pass  # nothing is written
    assert str(lost.value) == f"[Errno 2] No such file or directory: '{tmp_path / 'a.txt'}'"


def test_settings_say_where_to_find_what_they_refer_to() -> None:
    shown = RUNNER.invoke(app, ["settings", "vehicle_file"], env={"COLUMNS": "80"}).output
    assert "TOML file of a vehicle (section 7)" in " ".join(shown.split())
    assert "Section 7 is 'Vehicle': `egp settings --section 7` shows it." in shown
    vehicle = RUNNER.invoke(app, ["settings", "--section", "7"], env={"COLUMNS": "80"}).output
    assert "7. Vehicle" in vehicle
    assert "peak_slip" in vehicle
    assert "cost.lateral" not in vehicle
    assert "sections are 1 to 8" in failure("settings", "--section", "9")
    everything = RUNNER.invoke(app, ["settings"], env={"COLUMNS": "200"}).output
    assert "(docs/problem.md, section 8)" in " ".join(everything.split())
    titles = re.findall(r"^ *(\d)\. [A-Z]", everything, re.MULTILINE)
    assert titles == [*"12345678"]
    assert "shows it" not in everything


def test_the_doctor_checks_machine_and_library(tmp_path: Path) -> None:
    checks = {check.name: check for check in run_checks()}
    assert checks["library"].verdict == checks["zenoh"].verdict == "ok"
    assert "solved" in checks["control step"].found
    broken = tmp_path / "broken.safetensors"
    data = bytearray(Path(LIBRARY).read_bytes())
    data[-100] ^= 1
    broken.write_bytes(data)
    assert run_checks(broken)[-1].verdict == "fail"
    for file, reason in (
        (tmp_path, "expected a regular file, got a folder, a pipe or a device"),
        (tmp_path / "absent", "No such file or directory"),
    ):
        found = run_checks(file)[-1].found
        assert found.startswith(f"{file}: {reason}")
        assert "PosixPath" not in found
    assert RUNNER.invoke(app, ["doctor", str(broken)]).exit_code == 1


def test_programs_of_the_extension_get_the_options(capfd: pytest.CaptureFixture[str]) -> None:
    assert RUNNER.invoke(app, ["load", "--vehicles", "0"]).exit_code == 2
    assert "0 is not in 1..=2000" in capfd.readouterr().err
    assert RUNNER.invoke(app, ["load", "--json", "nowhere/load.json"]).exit_code == 1
    assert "cannot write the report nowhere/load.json: No such file" in capfd.readouterr().err
    assert "give --replay run.mcap" in failure("load", "--ramp", "0.99")
    assert "give --replay run.mcap" in failure("load", "--ramp=0.99")
    assert RUNNER.invoke(app, ["load", "--ramp=0.9", "--requests=nowhere.bin"]).exit_code == 1
    assert "nowhere.bin" in capfd.readouterr().err
    assert RUNNER.invoke(app, ["simulate", "--seed", "7", "--seconds", "0.2"]).exit_code == 0
    assert "seed 7: trace " in capfd.readouterr().out
    for program in ("load", "simulate"):
        assert RUNNER.invoke(app, [program, "--", "--help"]).exit_code == 0
        shown = capfd.readouterr().out
        assert f"Usage: egp {program} [OPTIONS]" in shown
        assert max(map(len, shown.splitlines())) <= 80


def test_requests_of_a_recording_are_written_behind_their_lengths() -> None:
    requests = [b"\x08" + bytes(length) for length in (0, 126, 127, 20_000)]
    steps = [RecordedStep(0.0, np.zeros(7), request, None) for request in requests]
    recorded = Recorded({}, None, {}, None, steps, complete=True)
    file = BytesIO()
    write_requests(recorded, file)
    # The lengths as varints.
    lengths = [b"\x01", b"\x7f", b"\x80\x01", b"\xa1\x9c\x01"]
    joined = b"".join(length + request for length, request in zip(lengths, requests, strict=True))
    assert file.getvalue() == joined


def test_a_port_in_use_and_a_wrong_endpoint_are_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        message = failure("serve", LIBRARY, "--listen", endpoint)
        assert f"cannot listen on {endpoint}: Address already in use" in message
        assert failure("map", "--listen", endpoint) == message
    assert why_not_free(endpoint) is None
    assert "did you mean 'tcp/127.0.0.1:7447'" in failure("drive", "--connect", "127.0.0.1:7447")
    for host in ("a..b", f"{'x' * 64}.example"):
        for why in (why_not_free, why_unreachable):
            told = why(f"tcp/{host}:7447")
            assert told == "a part of the host's name is empty or longer than 63 letters"
    check_endpoints(["tcp/127.0.0.1:7447", "tls/[::1]:7447", "unixsock-stream//tmp/socket"])


def test_training_does_not_begin_with_what_fails_at_its_end(tmp_path: Path) -> None:
    # Constant columns are an error of training itself, so that any other error came before it.
    steps = np.tile(np.arange(10, dtype=np.uint32), 4)
    data = Dataset(
        z=np.ones((40, 6)),
        y=np.ones((40, 3)),
        trajectory=np.repeat(np.arange(4, dtype=np.uint32), 10),
        step=steps,
        provenance=Provenance(0.05, "own car", "asphalt", 0.8, 0, "test", "test"),
    )
    with pytest.raises(IsADirectoryError, match="this is a folder"):
        data.write(tmp_path)
    log = tmp_path / "log.parquet"
    data.write(log)
    library = str(tmp_path / "library.safetensors")
    told = failure("train", str(log), "-o", library)
    assert "vehicle 'own car' are not known" in told
    assert "--vehicle" in told
    within = log / "library.safetensors"
    result = RUNNER.invoke(app, ["train", str(log), "-o", str(within)])
    assert "this is no folder" in str(result.exception)
    told = failure("train", str(log), "-o", library, "--picture", str(tmp_path))
    assert told == f"{tmp_path} is a folder: name a file in it"


def test_a_drive_that_cannot_begin_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "expected MODULE:CLASS" in failure("drive", "--plant", "my_simulator", "--in-process")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("option", "used"),
    [
        (["--fleet", "tcp/127.0.0.1:9"], "egp_service.control.fleet_map.FleetMap"),
        (["--monitor", "tcp/127.0.0.1:9"], "egp_service.cli.publication.StatusPublisher"),
        (["--connect", "tcp/127.0.0.1:9"], "egp_service.control.client.VehicleClient.connect"),
    ],
)
def test_a_vehicle_of_another_fleet_is_named_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: list[str], used: str
) -> None:
    def called(*_: object, fleet: str, vehicle: str, **__: object) -> None:
        raise EgpError(f"{vehicle} of {fleet}")

    monkeypatch.setattr(used, called)
    where = option if "--connect" in option else [*option, "--in-process"]
    command = ["drive", "-s", "random", *where, "-o", str(tmp_path)]
    for name, told in (("depot/car-1", "car-1 of depot"), ("car-1", "car-1 of default")):
        assert failure(*command, "--vehicle", name) == told


def test_a_dataset_is_a_parquet_file_of_a_positive_period(tmp_path: Path) -> None:
    file = str(tmp_path / "wet.csv")
    assert "wet.parquet" in failure("collect", "--friction", "0.5", "-o", file)
    file = str(tmp_path / "wet.parquet")
    assert "--dt" in failure("collect", "--friction", "0.5", "-o", file, "--dt", "0")


def test_keys_shows_the_command_of_a_vehicle_that_it_made_a_key_for(tmp_path: Path) -> None:
    pytest.importorskip("cryptography", reason="the extra `security` is not installed")
    folder = str(tmp_path / "secrets")
    for vehicles in (["car-1"], ["car-1", "car-2"]):
        options = [option for name in vehicles for option in ("--vehicle", name)]
        result = RUNNER.invoke(app, ["keys", folder, *options, "--host", "127.0.0.1"])
        last = vehicles[-1]
        shown = f"--vehicle default/{last} --zenoh {folder}/vehicles/default@{last}.json5"
        assert shown in result.output, result.output
    assert "New vehicles: default/car-2\nRenewed vehicles" in result.output
    assert ": default/car-1\n" in result.output


def test_files_of_another_kind_are_named(tmp_path: Path) -> None:
    settings, log = tmp_path / "soft.toml", tmp_path / "log.csv"
    settings.write_text("[cost]\nlaterall = 20.0\n")
    assert f"{settings}: " in failure("serve", LIBRARY, "--settings", str(settings))
    assert "line 2" in failure("serve", LIBRARY, "--settings", str(settings))
    assert f"--settings {settings}" in failure("serve", "--config", str(settings))
    settings.write_text('library = "a"\n')
    assert "`egp serve --config`" in failure("serve", LIBRARY, "--settings", str(settings))
    with pytest.raises(EgpError, match="got the path"):
        Controller(LIBRARY, str(settings), gate=Plant().parameters.gate_limits())
    log.write_text("t,v\n0,1\n0.02,1\n")
    assert "`egp collect --from-log`" in failure("train", str(log), "-o", str(tmp_path / "l"))
    missing = failure(
        *("collect", "-o", str(log.with_suffix(".parquet")), "--friction", "0.5"),
        *("--from-log", str(log)),
        *("--column", "time=t:s"),
    )
    assert "no column is named for v_x, v_y, omega, delta, F_x or a_x" in missing
    assert "log.csv has the columns t, v" in missing
    parquet = tmp_path / "data.parquet"
    parquet.write_bytes(b"PAR1" + bytes(100))
    with pytest.raises(EgpError, match=r"data.parquet: this is a Parquet file.*egp train"):
        Library.load(parquet)
    assert f"{log}: this is not a library file" in failure("inspect", str(log))
    log.write_bytes("x_m,y_m,größe\n".encode("latin-1"))
    with pytest.raises(
        EgpError, match=r"log.csv: expected a text in UTF-8, got .*; save the table in this"
    ):
        Road.from_csv(log)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(EgpError, match=r"pipe: expected a regular file, got a folder, a pipe"):
        Road.from_csv(pipe)


def test_serve_has_the_options_of_the_server_in_the_same_words() -> None:
    source = (DOCUMENT.parents[1] / "rust/service/src/bin/egp-server.rs").read_text("utf-8")
    told = re.findall(r"/// (.+)\n    #\[arg\(long.*\)\]\n    (\w+): ", source)
    group: Group = get_command(app)  # type: ignore[assignment]
    options = {
        option.name: getattr(option, "help", None) for option in group.commands["serve"].params
    }
    assert {name: options[name] for _, name in told} == {name: text for text, name in told}
    assert len(told) > 8


def test_options_of_serve_override_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configurations: list[str] = []
    monkeypatch.setattr("egp_service._core.serve", configurations.append)
    file = tmp_path / "service.toml"
    file.write_text(
        'library = "a"\nworkers = 1\nlog = "warn"\n'
        '[zenoh]\n"listen/endpoints" = "[]"\n"scouting/multicast/enabled" = "true"\n'
    )
    given = ["--workers=2", "--http=127.0.0.1:9464", "--connect=tcp/127.0.0.1:7448", "--log-json"]
    result = RUNNER.invoke(app, ["serve", LIBRARY, "--config", str(file), *given])
    assert result.exit_code == 0, result.output
    assert tomllib.loads(configurations[0]) == {
        "library": LIBRARY,
        "workers": 2,
        "log": "warn",
        "http": "127.0.0.1:9464",
        "log_json": True,
        "zenoh": {
            "listen/endpoints": "[]",
            "scouting/multicast/enabled": "true",
            "connect/endpoints": '["tcp/127.0.0.1:7448"]',
        },
    }


def test_paths_of_a_maps_configuration_start_at_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configurations: list[str] = []
    monkeypatch.setattr("egp_service._core.serve_map", configurations.append)
    file = tmp_path / "map.toml"
    file.write_text('folder = "roads"\nzenoh_file = "/keys/map.json5"\nlifetime = 60.0\n')
    result = RUNNER.invoke(app, ["map", "--config", str(file)])
    assert result.exit_code == 0, result.output
    assert tomllib.loads(configurations[0]) == {
        "folder": str(tmp_path / "roads"),
        "zenoh_file": "/keys/map.json5",
        "lifetime": 60.0,
    }
    file.write_bytes(b"\xff")
    assert "map.toml: expected a TOML file" in failure("map", "--config", str(file))
    monkeypatch.undo()
    file.write_text("# of ours\n\nlifetime = 0\n")
    told = failure("map", "--config", str(file))
    assert told == f"{file}: `lifetime` must be 1 to 1e9 s, got 0"


def test_an_error_of_a_configuration_names_the_file_and_no_line_of_another_text(
    tmp_path: Path,
) -> None:
    file = tmp_path / "service.toml"
    for text, told in (
        ('library = "a"\n# of ours\nwatch_mss = 5\n', "unknown field `watch_mss`"),
        ('library = "a"\n\n[settings]\ncost.lateral = "much"\n', "invalid type: string"),
        ('# of ours\nreplica = "a"\n', "missing field `library`"),
    ):
        file.write_text(text)
        message = failure("serve", "--config", str(file), "--check")
        assert message.startswith(f"{file}: ")
        assert told in message
        assert "TOML parse error" not in message
        line = text.splitlines()[-1].removeprefix("cost.")
        assert (f"in the line `{line}`" in message) == ("missing" not in told)


def test_serve_checks_what_it_would_serve(tmp_path: Path) -> None:
    result = RUNNER.invoke(app, ["serve", LIBRARY, "--check", "--workers", "1"])
    assert result.exit_code == 0, result.output
    library = Library.load(LIBRARY)
    assert result.output.splitlines() == [
        f"library {library.id}",
        f"surfaces: {', '.join(member.label for member in library.members)}",
        "period 0.02 s, horizon 40, window 25",
        "Configuration, library and network settings are valid.",
    ]
    assert "nonsense" in failure("serve", LIBRARY, "--check", "--http", "nonsense")
    file = tmp_path / "service.toml"
    file.write_text(f'library = "{LIBRARY}"\nlog = "egp=nonsense"\n')
    assert "nonsense" in failure("serve", "--config", str(file), "--check")


def test_serve_checks_a_service_behind_a_router(tmp_path: Path) -> None:
    file = tmp_path / "service.toml"
    network = '[zenoh]\n"mode" = \'"client"\'\n"listen/endpoints" = "[]"\n'
    file.write_text(f'library = "{LIBRARY}"\n{network}')
    connect = ("--connect", "tcp/127.0.0.1:7449")  # nobody needs to listen there
    command = ["serve", "--config", str(file), "--check", "--workers", "1"]
    result = RUNNER.invoke(app, [*command, *connect])
    assert result.exit_code == 0, result.output
    assert "zenoh" in failure(*command)
