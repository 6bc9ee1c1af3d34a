"""Commands of `egp` that drive with a service: how they end, and how they reach it."""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from urllib.request import urlopen

import pytest
import zenoh
from mcap.reader import make_reader
from typer.testing import CliRunner

from egp_service._core import EgpError
from egp_service.cli import app, signals
from egp_service.cli.options import NOT_COMPLETED
from egp_service.cli.status_line import MODE_STYLES
from egp_service.control.endpoints import free_endpoint, free_port, why_unreachable
from egp_service.control.service_process import ServiceProcess
from egp_service.control.session import session_config
from egp_service.simulation.scenario import library_path, load_scenario
from patience import ATTEMPTS, PATIENCE, wait_until
from road_evidence import measured
from road_messages import evidence, tile_key

LIBRARY = library_path(load_scenario("rounded-rectangle"))
LONG = """
name = "long"
laps = 50.0
[track]
kind = "circle"
[[zones]]
start = 0.0
friction = 1.0
"""


def group_lives(leader: int) -> bool:
    try:
        os.killpg(leader, 0)
    except ProcessLookupError:
        return False
    return True


def has_steps(runs: Path) -> bool:
    """Whether a drive has recorded steps: its header has 2 kB, and its first 50 steps 300 kB."""
    return any(file.stat().st_size > 100_000 for file in runs.glob("*/run.mcap"))


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_ends_a_drive_with_its_service_and_its_files(
    tmp_path: Path, sent: signal.Signals
) -> None:
    (tmp_path / "temporary").mkdir()
    scenario = tmp_path / "long.toml"
    scenario.write_text(LONG, encoding="utf-8")
    runs = tmp_path / "runs"
    command = [sys.executable, "-m", "egp_service", "drive", "-s", str(scenario), "-o", str(runs)]
    process = subprocess.Popen(
        command,
        env=os.environ | {"TMPDIR": str(tmp_path / "temporary")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        wait_until(lambda: has_steps(runs))
        assert list((tmp_path / "temporary").iterdir())
        process.send_signal(sent)
        output, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 128 + sent, output
        assert "Traceback" not in output
        assert "Interrupted. What was recorded until then is in" in output
        wait_until(lambda: not group_lives(process.pid))
        assert not list((tmp_path / "temporary").iterdir())
        (run,) = runs.iterdir()
        assert not [file for file in run.iterdir() if file.name.startswith(".")]
        # What was recorded until then can be read.
        with (run / "run.mcap").open("rb") as stream:
            assert make_reader(stream).get_header().profile is not None
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def test_a_drive_that_is_killed_leaves_no_service_and_no_files_of_it(tmp_path: Path) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    scenario = tmp_path / "long.toml"
    scenario.write_text(LONG, encoding="utf-8")
    runs = tmp_path / "runs"
    process = subprocess.Popen(
        [sys.executable, "-m", "egp_service", "drive", "-s", str(scenario), "-o", str(runs)],
        env=os.environ | {"TMPDIR": str(temporary)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        wait_until(lambda: has_steps(runs))
        assert list(temporary.glob("egp-service-*"))
        process.kill()
        process.wait()
        wait_until(lambda: not group_lives(process.pid))
        assert not list(temporary.glob("egp-service-*"))
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.parametrize("command", ["serve", "map"])
def test_a_log_that_cannot_be_written_ends_nothing(command: str) -> None:
    library = [str(LIBRARY)] if command == "serve" else []
    endpoint = free_endpoint()
    with Path("/dev/full").open("w") as full:
        process = subprocess.Popen(
            [sys.executable, "-m", "egp_service", command, *library, "--listen", endpoint],
            stderr=full,
        )
    try:
        wait_until(lambda: why_unreachable(endpoint) is None or process.poll() is not None)
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 0
    finally:
        process.kill()
        process.wait()


def test_a_map_that_could_not_write_a_road_has_status_1(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    command = [sys.executable, "-m", "egp_service", "map", "--listen", endpoint]
    command += ["--folder", str(tmp_path / "roads")]
    # No file may have more than two blocks.
    process = subprocess.Popen(
        ["/bin/sh", "-c", 'ulimit -f 2; exec "$@"', "sh", *command],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        wait_until(lambda: why_unreachable(endpoint) is None)
        config = session_config([endpoint], PATIENCE, {})
        with zenoh.open(config) as session:
            payload = evidence(measured(0.5).tile(0), 0.0)
            (answer,) = session.get(tile_key("car", 0), payload=payload, timeout=PATIENCE)
            assert answer.ok is not None
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 1
    assert "1 of the map's roads could not be written" in errors


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
def test_a_server_that_is_asked_to_end_has_status_0(sent: signal.Signals) -> None:
    for command in (
        ["serve", str(LIBRARY), "--listen", "tcp/127.0.0.1:0"],
        ["map", "--listen", "tcp/127.0.0.1:0"],
        ["router", "--listen", "tcp/127.0.0.1:0"],
        ["monitor", "--listen", "tcp/127.0.0.1:0", "--port", "0"],
    ):
        process = subprocess.Popen(
            [sys.executable, "-m", "egp_service", *command],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )
        assert process.stdout is not None
        # The first line says that it has started, and the signal handlers are in place.
        first = process.stdout.readline()
        process.send_signal(sent)
        rest, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, (command, first, rest)
        assert b"Traceback" not in rest


def test_sighup_ends_the_monitor_on_any_loopback_address() -> None:
    port = free_port()
    command = ["monitor", "--listen", "tcp/127.0.0.1:0", "--host", "::1", "--port", str(port)]
    process = subprocess.Popen(
        [sys.executable, "-m", "egp_service", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    assert process.stdout is not None
    process.stdout.readline()  # the address of the page
    with urlopen(f"http://[::1]:{port}/", timeout=PATIENCE) as answer:
        assert answer.status == 200
    process.send_signal(signal.SIGHUP)
    rest, _ = process.communicate(timeout=PATIENCE)
    assert (process.returncode, rest) == (0, b"")


def test_a_service_may_have_as_many_connections_as_the_system_lets_it() -> None:
    endpoint = free_endpoint()
    command = [sys.executable, "-m", "egp_service", "serve", str(LIBRARY), "--listen", endpoint]
    limited = ["/bin/sh", "-c", 'ulimit -Sn 256; exec "$@"', "sh", *command]
    process = subprocess.Popen(limited, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: why_unreachable(endpoint) is None)
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        assert resource.prlimit(process.pid, resource.RLIMIT_NOFILE) == (most, most)
    finally:
        process.kill()
        process.wait()


def test_a_service_warns_if_another_one_has_its_name() -> None:
    with ServiceProcess(LIBRARY, {}) as first:
        connected = ["--connect", first.endpoint, "--listen", "tcp/127.0.0.1:0"]
        for name, warned in (("main", True), ("other", False)):
            command = ["serve", str(LIBRARY), "--replica", name, *connected]
            process = subprocess.Popen(
                [sys.executable, "-m", "egp_service", *command],
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
            assert process.stdout is not None
            said = b""
            while b" serving " not in said:
                line = process.stdout.readline()
                assert line, said
                said += line
            process.terminate()
            process.communicate(timeout=PATIENCE)
            assert (b"another service has this name" in said) == warned, said


def test_a_drive_says_that_nobody_listens_where_it_publishes(tmp_path: Path) -> None:
    scenario = tmp_path / "short.toml"
    scenario.write_text(LONG.replace("50.0", "0.02"), encoding="utf-8")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        endpoint = f"tcp/127.0.0.1:{listener.getsockname()[1]}"
        assert why_unreachable(endpoint) is None
    command = ["drive", "-s", str(scenario), "--in-process", "--no-pictures", "-o", str(tmp_path)]
    result = CliRunner().invoke(app, [*command, "--monitor", endpoint])
    assert result.exit_code == 0, result.output
    shown = " ".join(result.output.split())
    assert f"No program listens at {endpoint} (Connection refused)" in shown
    assert f"start `egp monitor --listen {endpoint}`" in shown
    assert "No program" not in CliRunner().invoke(app, command).output


@pytest.mark.parametrize(
    ("number", "raised"), [(signal.SIGTERM, SystemExit), (signal.SIGINT, KeyboardInterrupt)]
)
def test_what_a_signal_raised_is_raised_again_if_it_was_lost(
    monkeypatch: pytest.MonkeyPatch, number: int, raised: type[BaseException]
) -> None:
    monkeypatch.setattr(signals, "_received", [])
    signals.check()
    monkeypatch.setattr(signals, "_received", [number])
    with pytest.raises(raised):
        signals.check()


def test_a_signal_in_a_function_that_zenoh_calls_is_raised_after_it() -> None:
    code = """
import os, signal, zenoh
from egp_service.cli import signals
from egp_service.control.session import direct

def called():
    os.kill(os.getpid(), signal.SIGTERM)
    for _ in range(1000):
        pass
    print("called to its end")

direct(called)
signals.install()
called()
print("back")
signals.check()
print("not reached")
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=PATIENCE
    )
    assert done.returncode == 128 + signal.SIGTERM, done.stderr
    assert done.stdout.splitlines() == ["called to its end", "back"]
    assert not done.stderr


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_in_the_callback_of_a_weak_reference_is_raised_after_it(
    sent: signal.Signals,
) -> None:
    code = f"""
import os, weakref
from egp_service.cli import signals

class Referenced:
    pass

signals.install()
referenced = Referenced()
reference = weakref.ref(referenced, lambda _: os.kill(os.getpid(), {int(sent)}))
del referenced
print("back")
signals.check()
print("not reached")
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=PATIENCE
    )
    assert done.stdout.splitlines() == ["back"], done.stderr
    assert "ignored" not in done.stderr
    assert done.returncode == (-sent if sent == signal.SIGINT else 128 + sent)


def test_the_status_line_has_a_style_for_every_mode() -> None:
    assert set(MODE_STYLES) == {"normal", "tail", "stop", "waiting"}


def test_a_drive_reaches_a_service_by_a_configuration_of_zenoh(tmp_path: Path) -> None:
    short = tmp_path / "short.toml"
    short.write_text(LONG.replace("50.0", "0.02"), encoding="utf-8")
    settings = tmp_path / "zenoh.json5"
    arguments = ["drive", "-s", str(short), "--no-pictures"]
    with ServiceProcess(LIBRARY, {}) as service:
        settings.write_text(f"{{connect: {{endpoints: ['{service.endpoint}']}}}}", encoding="utf-8")
        for attempt in range(ATTEMPTS):
            runs = tmp_path / f"runs-{attempt}"
            result = CliRunner().invoke(
                app, [*arguments, "--zenoh", str(settings), "-o", str(runs)]
            )
            if result.exit_code != NOT_COMPLETED:  # as on a machine that stalls
                break
        assert result.exit_code == 0, result.output
        # The same service answers the recorded requests.
        (recording,) = runs.glob("*/run.mcap")
        report = tmp_path / "load.json"
        replay = ["load", "--replay", str(recording), "--connect", service.endpoint]
        options = ["--vehicles", "2", "--seconds", "1", "--ramp", "0.5", "--most", "3"]
        figure = ["--picture", str(report.with_suffix(".png"))]
        assert CliRunner().invoke(app, [*replay, *options, *figure]).exit_code == 0
    rates = json.loads(report.read_text())["rates"]
    assert [rate["vehicles"] for rate in rates] == [2, 3]
    assert rates[0]["in_deadline"] > 0
    assert report.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    result = CliRunner().invoke(app, ["load", *figure])
    assert isinstance(result.exception, EgpError)
    assert "give --replay run.mcap" in str(result.exception)
    for name, expected in (
        (report, "load.json does not name a picture"),
        (report / "knee.png", "this is no folder"),
    ):
        result = CliRunner().invoke(app, [*replay, "--picture", str(name)])
        assert isinstance(result.exception, EgpError | OSError)
        assert expected in str(result.exception)
    settings.write_text("{conect: {}}", encoding="utf-8")
    result = CliRunner().invoke(app, [*arguments, "--zenoh", str(settings)])
    assert isinstance(result.exception, EgpError)
    assert "zenoh.json5" in str(result.exception)


@pytest.mark.parametrize("option", ["--config", "--settings"])
def test_a_configuration_that_is_not_toml_is_an_error_in_words(tmp_path: Path, option: str) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text("[[zenoh", encoding="utf-8")
    library = [] if option == "--config" else [str(LIBRARY)]
    result = CliRunner().invoke(app, ["serve", *library, option, str(broken)])
    assert isinstance(result.exception, EgpError)
    assert "broken.toml is not TOML" in str(result.exception)
