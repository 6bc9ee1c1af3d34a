"""Libraries are fetched by their SHA-256 from any replica that has them.

Replicas and those who answer wrongly are zenoh sessions in processes of their own.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from security_programs import (
    GATE,
    LIBRARY,
    PATIENCE,
    client,
    drive,
    first,
    program,
    secrets,
    service,
)
from typer.testing import CliRunner

from egp_service import EgpError, VehicleClient, shipped
from egp_service._core import InvalidArgumentError, Library
from egp_service.cli import app
from egp_service.cli.signing import sign_library
from egp_service.control.endpoints import free_endpoint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

LARGE = shipped.EVALUATION_LIBRARY
SHA256 = hashlib.sha256(LARGE.read_bytes()).hexdigest()
HOLDER = str(Path(__file__).with_name("holder.py"))


def fetch(file: Path, *options: str, sha256: str = SHA256, timeout: float = PATIENCE) -> str:
    """Run `egp fetch` and return what it prints; its error is raised."""
    command = ["fetch", sha256, "-o", str(file), "--timeout", str(timeout), *options]
    result = CliRunner().invoke(app, command)
    if result.exception is not None:
        raise result.exception
    return result.output


def refused(
    reason: str,
    file: Path,
    *options: str,
    sha256: str = SHA256,
    timeout: float = 1.0,
    source: Callable[[], AbstractContextManager[object]] = nullcontext,
) -> None:
    """Fail to fetch for this reason, with more time if a busy machine has not answered in time."""
    for factor in (1, 4, 16):
        with source(), pytest.raises(EgpError) as caught:
            fetch(file, *options, sha256=sha256, timeout=factor * timeout)
        if re.search(reason, str(caught.value)):
            return
    raise AssertionError(str(caught.value))


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@contextmanager
def further(folder: Path, endpoint: str, *lines: str, **settings: bool) -> Iterator[None]:
    """Serve the large library beside the one that `ready` describes."""
    with service(folder, endpoint, f'libraries = ["{LARGE}"]', *lines, **settings):
        yield


@pytest.fixture
def output(tmp_path: Path) -> Path:
    """Name the file that is fetched, alone in its folder."""
    (tmp_path / "output").mkdir()
    return tmp_path / "output" / "library.safetensors"


def test_a_new_replica_starts_from_a_hash_and_passes_the_library_on(tmp_path: Path) -> None:
    """The second replica has no file of the library, and the first one ends before the third."""
    endpoints = [free_endpoint() for _ in range(2)]
    own = tmp_path / "library.safetensors"
    listen, connect = ("--listen", endpoints[1]), ("--connect", endpoints[0])
    command = ("-m", "egp_service", "serve", str(own), "--fetch", SHA256)
    with program(*command, "--replica", "second", *listen, *connect, folder=tmp_path):
        time.sleep(1.0)  # it asks before there is anybody
        assert not own.exists()
        with further(tmp_path, endpoints[0]), client(endpoints[1]) as session:
            assert first(session, "egp/v1/r/second/health") is not None
        assert own.read_bytes() == LARGE.read_bytes()
        third = tmp_path / "third.safetensors"
        assert "from replica second" in fetch(third, "--connect", endpoints[1])
        assert third.read_bytes() == LARGE.read_bytes()
        # The file is there, so nobody is asked.
        assert "already" in fetch(third, "--connect", free_endpoint())
    # The same holds for a replica that starts again.
    with (
        program(*command, *listen, "--connect", free_endpoint(), folder=tmp_path),
        VehicleClient.connect([endpoints[1]], gate=GATE, timeout=PATIENCE) as vehicle,
    ):
        assert vehicle.library.hex() == SHA256
    assert not [name for name in files(tmp_path) if name.endswith(".part")]


def test_a_library_that_cannot_be_written_leaves_the_old_one_and_its_signature(
    tmp_path: Path, output: Path
) -> None:
    own = secrets(tmp_path / "own", "tls/127.0.0.1:7460")
    shutil.copy(LARGE, tmp_path / "large.safetensors")
    shutil.copy(LIBRARY, output)
    for file in (tmp_path / "large.safetensors", output):
        sign_library(file, own / "library.key")
    before = {path: path.read_bytes() for path in output.parent.iterdir()}
    endpoint = free_endpoint()
    with service(tmp_path, endpoint, f'libraries = ["{tmp_path / "large.safetensors"}"]'):
        command = [sys.executable, "-m", "egp_service", "fetch", SHA256, "-o", str(output)]
        command += ["--connect", endpoint, "--keys", str(own / "library.pub")]
        # No file may have more than 20 blocks.
        limited = ["/bin/sh", "-c", 'ulimit -f 20; exec "$@"', "sh", *command]
        fetched = subprocess.run(limited, capture_output=True, text=True, check=False)
    assert fetched.returncode == 1
    assert f"cannot write {output}: File too large" in fetched.stderr
    assert {path: path.read_bytes() for path in output.parent.iterdir()} == before


def test_a_library_is_fetched_through_a_router(tmp_path: Path, output: Path) -> None:
    endpoint = free_endpoint()
    route = ("-m", "egp_service", "router", "--listen", endpoint)
    with program(*route, folder=tmp_path), further(tmp_path, endpoint, router=True):
        fetch(output, "--connect", endpoint)
    assert Library.load(output).id == SHA256


@pytest.mark.parametrize(
    ("mode", "reason"),
    [
        ("noise", "not an egp.v1 message"),
        ("large", "it has 536870913 bytes, a library at most 536870912"),
        ("long", "expected 65536 bytes in part 0, got 65537"),
        ("short", "expected 65536 bytes in part 0, got 65535"),
        ("wrong", "what it sent has SHA-256 "),
        ("half", "no answer for part 2 of 7"),
        ("silent", "no answer for part 1 of 7"),
    ],
)
def test_a_wrong_answer_changes_no_file(
    tmp_path: Path, output: Path, mode: str, reason: str
) -> None:
    """The old file stays, and another replica's answer is used in its place."""
    endpoint, honest = free_endpoint(), free_endpoint()
    shutil.copyfile(LIBRARY, output)

    @contextmanager
    def stray() -> Iterator[None]:
        with program(HOLDER, mode, endpoint, str(LARGE), folder=tmp_path):
            with client(endpoint) as session:
                assert first(session, "egp/v1/r/*/library/" + SHA256) is not None
            yield

    reason = f"no replica gave .*: replica stray: .*{reason}"
    refused(reason, output, "--connect", endpoint, timeout=2.0, source=stray)
    assert output.read_bytes() == LIBRARY.read_bytes()
    assert files(output.parent) == {output.name}
    with (
        program(HOLDER, mode, endpoint, str(LARGE), folder=tmp_path),
        further(tmp_path, honest),
    ):
        for own in (endpoint, honest):
            with client(own) as session:
                assert first(session, "egp/v1/r/*/library/" + SHA256) is not None
        both = ("--connect", endpoint, "--connect", honest)
        assert "from replica main" in fetch(output, *both)
    assert output.read_bytes() == LARGE.read_bytes()


def test_bytes_with_the_right_hash_that_are_no_library_change_no_file(
    tmp_path: Path, output: Path
) -> None:
    endpoint, noise = free_endpoint(), tmp_path / "noise"
    noise.write_bytes(b"no library")
    sha256 = hashlib.sha256(b"no library").hexdigest()
    with program(HOLDER, "honest", endpoint, str(noise), folder=tmp_path):
        reason = "replica stray: it cannot be used: "
        refused(reason, output, "--connect", endpoint, sha256=sha256, timeout=PATIENCE / 6)
    assert files(output.parent) == set()


def test_what_nobody_has_is_an_error_that_names_who_was_asked(tmp_path: Path, output: Path) -> None:
    endpoint = free_endpoint()
    with service(tmp_path, endpoint):
        with client(endpoint) as session:
            assert first(session, "egp/v1/r/main/health") is not None
        reason = f"replica main does not serve library {SHA256}"
        refused(reason, output, "--connect", endpoint)
    with pytest.raises(EgpError, match="no replica answered"):
        fetch(output, "--connect", endpoint, timeout=0.5)
    with pytest.raises(InvalidArgumentError, match="expected 64 hexadecimal digits"):
        fetch(output, "--connect", endpoint, sha256="6f1c")
    with pytest.raises(EgpError, match="no replica to fetch from"):
        fetch(output)
    assert files(output.parent) == set()
    missing = output.parent / "missing" / "library.safetensors"
    with (
        further(tmp_path, endpoint),
        pytest.raises(EgpError, match=r"cannot write .*missing/library.safetensors"),
    ):
        fetch(missing, "--connect", endpoint)


def test_a_signature_comes_with_the_library_and_is_demanded(tmp_path: Path, output: Path) -> None:
    own, foreign = (secrets(tmp_path / name, "tls/h:7447") for name in ("own", "foreign"))
    endpoint, signed = free_endpoint(), tmp_path / "signed.safetensors"
    shutil.copyfile(LARGE, signed)
    options = ("--connect", endpoint, "--keys", str(own / "library.pub"))
    line = f'libraries = ["{signed}"]'
    for key, reason in ((None, "it has no signature"), (foreign, "not signed by any of the 1")):
        if key is not None:
            sign_library(signed, key / "library.key")
        with service(tmp_path, endpoint, line):
            with client(endpoint) as session:
                assert first(session, "egp/v1/r/main/library/" + SHA256) is not None
            refused(f"replica main: .*{reason}", output, *options)
    assert files(output.parent) == set()
    signature = sign_library(signed, own / "library.key")
    with service(tmp_path, endpoint, line):
        fetch(output, *options)
    beside = output.with_name(output.name + ".sig")
    assert beside.read_bytes() == signature.read_bytes()
    # The signature of an earlier library does not stay beside one that has none.
    shutil.copyfile(LIBRARY, output)
    with further(tmp_path, endpoint):
        fetch(output, "--connect", endpoint)
    assert files(output.parent) == {output.name}


def test_certificates_let_services_and_operators_fetch(tmp_path: Path, output: Path) -> None:
    """A vehicle's question is not passed on, and a new replica fetches with its own certificate."""
    endpoint = free_endpoint("tls")
    own = secrets(tmp_path / "own", endpoint)
    line = f'zenoh_file = "{own / "service.json5"}"'
    with further(tmp_path, endpoint, line):
        options = ("--connect", endpoint, "--zenoh")
        fetch(output, *options, str(own / "operator.json5"))
        output.unlink()
        with pytest.raises(EgpError, match="no replica answered"):
            fetch(output, *options, str(own / "vehicles" / "f@a.json5"), timeout=2.0)
        second, config = free_endpoint("tls"), tmp_path / "second.toml"
        config.write_text(
            f'library = "{output}"\nfetch = "{SHA256}"\nreplica = "second"\n{line}\n[zenoh]\n'
            f'"listen/endpoints" = \'["{second}"]\'\n"connect/endpoints" = \'["{endpoint}"]\'\n',
            encoding="utf-8",
        )
        command = ("-m", "egp_service", "serve", "--config", str(config))
        with (
            program(*command, folder=tmp_path),
            client(second, own / "operator.json5") as session,
        ):
            assert first(session, "egp/v1/r/second/health") is not None
    assert output.read_bytes() == LARGE.read_bytes()


def test_a_check_asks_nobody_and_a_signal_ends_the_search(output: Path) -> None:
    command = [sys.executable, "-m", "egp_service", "serve", str(output), "--fetch", SHA256]
    command += ["--connect", free_endpoint(), "--listen", free_endpoint()]
    checked = subprocess.run([*command, "--check"], capture_output=True, text=True, check=False)
    assert checked.returncode == 1
    assert f"does not hold library {SHA256} yet" in checked.stderr
    for sent in (signal.SIGTERM, signal.SIGINT):
        with subprocess.Popen(command, stderr=subprocess.PIPE) as waiting:
            assert waiting.stderr is not None
            assert b"asking replicas for the library" in waiting.stderr.readline()
            waiting.send_signal(sent)
            assert waiting.wait(PATIENCE) == 0
    shutil.copyfile(LARGE, output)
    checked = subprocess.run([*command, "--check"], capture_output=True, text=True, check=False)
    assert (checked.returncode, SHA256 in checked.stdout) == (0, True), checked.stderr


def test_vehicles_get_their_plans_while_libraries_are_fetched(tmp_path: Path) -> None:
    """Four sessions ask for parts all the time, far more than the replica sends in a second."""
    endpoint = free_endpoint()
    with further(tmp_path, endpoint), ExitStack() as running:
        vehicle = running.enter_context(
            VehicleClient.connect([endpoint], gate=GATE, timeout=PATIENCE)
        )
        sent, ended = [0] * 4, threading.Event()

        def ask(number: int) -> None:
            with client(endpoint) as session:
                key = f"egp/v1/r/main/library/{SHA256}/{number}"
                while not ended.is_set():
                    for reply in session.get(key, timeout=2.0):
                        if reply.ok is not None:
                            sent[number] += len(reply.ok.payload.to_bytes())

        threads = [threading.Thread(target=ask, args=(number,)) for number in range(4)]
        begun = time.monotonic()
        for thread in threads:
            thread.start()
        late = begun + PATIENCE
        while min(sent) == 0:
            assert time.monotonic() < late
            time.sleep(0.02)
        steps = [step for _ in range(4) for step in drive(vehicle)]
        ended.set()
        for thread in threads:
            thread.join()
        rate = sum(sent) / (time.monotonic() - begun)
    assert [step.status for step in steps] == ["solved"] * len(steps)
    assert np.median([step.timings.total for step in steps]) < 0.1
    assert rate < (32 << 20) * 1.1
    print(json.dumps({"MiB/s": rate / (1 << 20)}))
