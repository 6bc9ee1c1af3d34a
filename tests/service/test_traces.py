"""The spans of vehicle and service join into one trace for each step, in the form of OTLP."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections import defaultdict
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

from egp_service import InvalidArgumentError, VehicleClient
from egp_service._core import EgpError
from egp_service.cli import app
from egp_service.control.endpoints import free_endpoint, why_unreachable
from egp_service.control.service_process import ServiceProcess
from egp_service.simulation.scenario import gate_settings, library_path, load_scenario
from frozen import freeze
from patience import PATIENCE, wait_for_replicas, wait_until
from standstill import Standstill

if TYPE_CHECKING:
    from collections.abc import Iterator


SCENARIO = load_scenario("rounded-rectangle")
LIBRARY = library_path(SCENARIO)
GATE = gate_settings(SCENARIO)
EGP = [sys.executable, "-m", "egp_service"]
# Each process reads its clock and the time of day within 20 us; a busy machine may interrupt it.
CLOCKS_NS = 200_000


@dataclass(frozen=True)
class Span:
    """A span as a file has it."""

    instance: str
    trace: str
    id: str
    parent: str
    name: str
    kind: int
    start: int
    end: int
    failed: bool
    attributes: dict[str, Any]

    def within(self, other: Span, tolerance: int = 0) -> bool:
        """Tell whether this span is a part of another one in time."""
        return other.start - tolerance <= self.start <= self.end <= other.end + tolerance


def read(path: Path) -> list[Span]:
    """Read a file by the schema of OTLP in JSON; an unknown field and a wrong type are errors.

    PyPI's `opentelemetry-proto` has the messages, but Ray, which other tests use, does not start
    beside it.
    """
    spans = []
    text = path.read_text(encoding="utf-8")
    assert text.endswith("\n")
    for line in text.splitlines():
        (groups,) = of_fields(json.loads(line), "resourceSpans")
        for group in groups:
            resource, scopes = of_fields(group, "resource", "scopeSpans")
            about = attributes(*of_fields(resource, "attributes"))
            assert about.keys() == {"service.name", "service.instance.id", "service.version"}
            for scope in scopes:
                writer, written = of_fields(scope, "scope", "spans")
                assert all(isinstance(text, str) for text in of_fields(writer, "name", "version"))
                spans += [of_json(about["service.instance.id"], span) for span in written]
    return spans


def of_fields(stated: dict[str, Any], *names: str) -> list[Any]:
    """Give the values of a message that has exactly these fields."""
    assert stated.keys() == set(names)
    return [stated[name] for name in names]


def of_json(instance: str, span: dict[str, Any]) -> Span:
    """Check a span's fields, of which those that say nothing are left out."""
    stated = {"parentSpanId": "", "attributes": [], "status": {"code": 0, "message": ""}} | span
    trace, own, parent, name, kind, start, end, stated_attributes, status = of_fields(
        stated,
        "traceId",
        "spanId",
        "parentSpanId",
        "name",
        "kind",
        "startTimeUnixNano",
        "endTimeUnixNano",
        "attributes",
        "status",
    )
    assert re.fullmatch("[0-9a-f]{32}", trace)
    assert re.fullmatch("[0-9a-f]{16}", own)
    assert re.fullmatch("([0-9a-f]{16})?", parent)
    assert isinstance(name, str)
    assert kind in {1, 2, 3}  # internal, server, client
    code, message = of_fields(status, "code", "message")
    assert code in {0, 2}  # not set, error
    assert isinstance(message, str)
    failed = code == 2
    return Span(
        instance,
        trace,
        own,
        parent,
        name,
        kind,
        integer(start),
        integer(end),
        failed,
        attributes(stated_attributes),
    )


def integer(stated: object) -> int:
    """Give an integer of 64 bits, which JSON of protobuf has as text."""
    assert isinstance(stated, str)
    assert re.fullmatch("-?[0-9]+", stated)
    return int(stated)


def attributes(stated: list[dict[str, Any]]) -> dict[str, Any]:
    """Give the attributes, which are texts and integers."""
    found: dict[str, Any] = {}
    for each in stated:
        key, value = of_fields(each, "key", "value")
        ((kind, content),) = value.items()
        assert kind in {"stringValue", "intValue"}
        assert kind != "stringValue" or isinstance(content, str)
        found[key] = content if kind == "stringValue" else integer(content)
    return found


def traces_of(spans: list[Span]) -> dict[str, list[Span]]:
    """Give the spans of each trace."""
    traces: dict[str, list[Span]] = defaultdict(list)
    for span in spans:
        traces[span.trace].append(span)
    return traces


@contextmanager
def serving(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run `egp serve`, and drain it at the end."""
    process = subprocess.Popen([*EGP, "serve", *arguments])
    try:
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.terminate()
        assert process.wait(PATIENCE) == 0


def test_vehicle_and_service_write_one_trace_for_each_step(tmp_path: Path) -> None:
    endpoint, ours, theirs = free_endpoint(), tmp_path / "car.jsonl", tmp_path / "server.jsonl"
    with (
        serving(str(LIBRARY), "--listen", endpoint, "--traces", str(theirs)),
        VehicleClient.connect(
            endpoint, fleet="depot", vehicle="car-7", gate=GATE, timeout=30.0, traces=ours
        ) as client,
    ):
        vehicle = Standstill(client, 5.0)
        steps = [vehicle.step() for _ in range(20)]
    assert all(step.status == "solved" for step in steps)
    assert {span.instance for span in read(ours)} == {"depot/car-7"}
    assert {span.instance for span in read(theirs)} == {"main"}
    traces = traces_of(read(ours) + read(theirs))
    assert len(traces) == len(steps)
    sequences = set()
    for spans in traces.values():
        by_name = {span.name: span for span in spans}
        names = {"step", "ask", "request", "receive", "queue", "solve"}
        assert by_name.keys() == {f"egp.{name}" for name in names}
        assert len(spans) == len(names) == len({span.id for span in spans})
        root, ask, request = by_name["egp.step"], by_name["egp.ask"], by_name["egp.request"]
        parts = [by_name[f"egp.{part}"] for part in ("receive", "queue", "solve")]
        assert (root.parent, ask.parent, request.parent) == ("", root.id, ask.id)
        assert {part.parent for part in parts} == {request.id}
        assert (root.kind, ask.kind, request.kind) == (1, 3, 2)
        assert ask.within(root)
        assert request.within(ask, CLOCKS_NS)
        assert all(part.within(request) for part in parts)
        assert parts[0].end == parts[1].start
        assert parts[1].end == parts[2].start
        assert abs(root.start - time.time_ns()) < 600e9
        assert not any(span.failed for span in spans)
        library = client.library.hex()
        about = {"egp.fleet": "depot", "egp.vehicle": "car-7", "egp.library": library}
        about["egp.sequence"] = root.attributes["egp.sequence"]
        expected = {"egp.outcome": "solved", "egp.mode": "normal", "egp.replica": "main"}
        assert root.attributes == about | expected
        assert request.attributes == about | {"egp.status": "solved"}
        assert ask.attributes == {"egp.replica": "main", "egp.answer": "reply"}
        sequences.add(root.attributes["egp.sequence"])
    assert len(sequences) == len(steps)


def test_both_sides_choose_the_same_share(tmp_path: Path) -> None:
    endpoint, ours = free_endpoint(), tmp_path / "car.jsonl"
    config = tmp_path / "service.toml"
    config.write_text(
        f'library = "{LIBRARY}"\ntraces = "server.jsonl"\ntraces_share = 0.3\n', encoding="utf-8"
    )
    with (
        serving("--config", str(config), "--listen", endpoint),
        VehicleClient.connect(
            endpoint, gate=GATE, timeout=30.0, traces=ours, traces_share=0.3
        ) as client,
    ):
        vehicle = Standstill(client, 5.0)
        for _ in range(60):
            assert vehicle.step().status == "solved"
    chosen = traces_of(read(ours)).keys()
    assert chosen == traces_of(read(tmp_path / "server.jsonl")).keys()
    assert 0 < len(chosen) < 60


def asked_alone(vehicle: Standstill, hedge: float, deadline: float) -> str:
    """Return the replica that answered a step before a second one was asked, and so is preferred.

    On a busy machine the preferred replica's first answers may be late, and another one's is used.
    """
    end = time.monotonic() + PATIENCE
    while True:
        begun = time.monotonic()
        replica = vehicle.step(deadline).replica
        if time.monotonic() - begun < hedge * deadline and replica:
            return replica
        assert time.monotonic() < end


def requests_in(file: Path) -> int:
    return file.read_bytes().count(b'"egp.request"')


def test_a_request_to_two_replicas_is_one_trace(tmp_path: Path) -> None:
    # The preferred replica is stopped for less than half a second: after two seconds its link would
    # be closed, and with it the question that it is to answer.
    hedge, deadline = 0.2, 2.0
    ours, replicas = tmp_path / "car.jsonl", ["a", "b"]
    endpoints = {name: free_endpoint() for name in replicas}
    files = {name: tmp_path / f"{name}.jsonl" for name in replicas}
    options = {
        name: ["--replica", name, "--listen", endpoints[name], "--traces", str(files[name])]
        for name in replicas
    }
    with serving(str(LIBRARY), *options["a"]) as a, serving(str(LIBRARY), *options["b"]) as b:
        processes = {"a": a, "b": b}
        connect = [endpoints[name] for name in replicas]
        with VehicleClient.connect(
            connect, gate=GATE, timeout=30.0, hedge=hedge, traces=ours
        ) as client:
            vehicle = Standstill(client, 5.0)
            wait_until(lambda: all(why_unreachable(each) is None for each in connect))
            wait_for_replicas(client, 2)
            first, waited = asked_alone(vehicle, hedge, deadline), False
            while not waited:
                answered = requests_in(files[first])
                freeze(processes[first])
                begun = time.monotonic()
                step = vehicle.step(deadline)
                waited = time.monotonic() - begun >= hedge * deadline
                processes[first].send_signal(signal.SIGCONT)
                other = {"a": "b", "b": "a"}[first]
                assert (step.status, step.replica) == ("solved", other)
                # A vehicle that only now has learned of the other replica may prefer it, and ask
                # it at once.
                first = first if waited else other
            # The replica answers the question that it had when it was stopped.
            wait_until(lambda: requests_in(files[first]) > answered)
    *_, newest = (span for span in read(ours) if span.name == "egp.step")
    (spans,) = [
        spans
        for trace, spans in traces_of(read(ours) + read(files["a"]) + read(files["b"])).items()
        if trace == newest.trace
    ]
    asks = {span.attributes["egp.replica"]: span for span in spans if span.name == "egp.ask"}
    requests = {span.instance: span for span in spans if span.name == "egp.request"}
    assert asks.keys() == requests.keys() == set(replicas)
    assert {asks[name].id for name in replicas} == {requests[name].parent for name in replicas}
    assert all(requests[name].parent == asks[name].id for name in replicas)
    assert asks[first].attributes["egp.answer"] == "late"
    assert asks[first].failed
    assert not newest.failed


def test_a_step_without_a_service_says_why_it_has_no_plan(tmp_path: Path) -> None:
    ours = tmp_path / "car.jsonl"
    with (
        ServiceProcess(LIBRARY, {}) as service,
        VehicleClient.connect(service.endpoint, gate=GATE, traces=str(ours)) as client,
    ):
        vehicle, end = Standstill(client, 5.0), time.monotonic() + PATIENCE
        assert vehicle.step().status == "solved"
        service.kill()
        while vehicle.step(deadline=0.5).status != "unreachable":
            assert time.monotonic() < end
    *_, newest = (span for span in read(ours) if span.name == "egp.step")
    assert newest.failed
    assert newest.attributes["egp.outcome"] == "unreachable"
    assert newest.attributes["egp.mode"] in {"tail", "stop"}


def test_a_stranger_takes_no_space_on_the_disk_of_a_service_with_keys(tmp_path: Path) -> None:
    endpoint, ours = free_endpoint(), tmp_path / "car.jsonl"
    keys, known = tmp_path / "vehicles.keys", tmp_path / "car.key"
    for file in (keys, known):
        file.write_text(f"default/vehicle-1 {'5a' * 32}\n", encoding="utf-8")
    config = tmp_path / "service.toml"
    config.write_text(
        f'library = "{LIBRARY}"\nvehicle_keys = "vehicles.keys"\ntraces = "server.jsonl"\n',
        encoding="utf-8",
    )
    with (
        serving("--config", str(config), "--listen", endpoint) as service,
        VehicleClient.connect(
            endpoint, gate=GATE, timeout=30.0, traces=ours, key_file=known
        ) as client,
    ):
        # The vehicle becomes a stranger: its key is replaced at the service.
        keys.write_text(f"default/vehicle-1 {'5b' * 32}\n", encoding="utf-8")
        service.send_signal(signal.SIGHUP)
        vehicle, end = Standstill(client, 5.0), time.monotonic() + PATIENCE
        while vehicle.step().status != "refused":
            assert time.monotonic() < end
    *_, ask, root = read(ours)
    assert ask.attributes["egp.answer"] == root.attributes["egp.outcome"] == "refused"
    assert {span.attributes["egp.error_code"] for span in (ask, root)} == {"unauthenticated"}
    assert ask.failed
    assert root.failed
    assert ask.trace not in (tmp_path / "server.jsonl").read_text(encoding="utf-8")


def test_a_drive_writes_its_traces(tmp_path: Path) -> None:
    scenario = tmp_path / "short.toml"
    scenario.write_text(
        'name = "short"\nlaps = 0.02\n[track]\nkind = "circle"\n[[zones]]\nstart = 0.0\n'
        "friction = 1.0\n",
        encoding="utf-8",
    )
    traces = tmp_path / "car.jsonl"
    drive = ["drive", "-s", str(scenario), "--no-pictures", "-o", str(tmp_path / "runs")]
    with ServiceProcess(LIBRARY, {}) as service:
        options = ["--connect", service.endpoint, "--traces", str(traces)]
        result = CliRunner().invoke(app, [*drive, *options])
    assert result.exit_code == 0, result.output
    assert {span.instance for span in read(traces)} == {"default/vehicle-1"}
    for unused in (["--traces", str(traces)], ["--vehicle", "car-2"]):
        result = CliRunner().invoke(app, [*drive, *unused])
        assert result.exit_code == 1
        assert "no use without" in str(result.exception)


def test_a_file_that_cannot_be_written_is_named_at_the_start(tmp_path: Path) -> None:
    missing = tmp_path / "missing" / "traces.jsonl"
    serve = ["serve", str(LIBRARY), "--listen", free_endpoint(), "--traces", str(missing)]
    result = CliRunner().invoke(app, [*serve, "--check"])
    assert isinstance(result.exception, EgpError)
    assert f"cannot write traces to {missing}" in str(result.exception)
    done = subprocess.run(
        [*EGP, *serve], capture_output=True, text=True, check=False, timeout=PATIENCE
    )
    assert done.returncode != 0
    assert "cannot write traces" in done.stderr
    with ServiceProcess(LIBRARY, {}) as service:
        with pytest.raises(InvalidArgumentError, match="cannot write traces"):
            VehicleClient.connect(service.endpoint, gate=GATE, traces=missing)
        with pytest.raises(InvalidArgumentError, match="from 0 to 1"):
            VehicleClient.connect(
                service.endpoint, gate=GATE, traces=tmp_path / "a", traces_share=2.0
            )


@pytest.mark.skipif(sys.platform != "linux", reason="writes to /dev/full")
def test_a_full_disk_does_not_stop_control() -> None:
    full, endpoint = Path("/dev/full"), free_endpoint()
    with serving(str(LIBRARY), "--listen", endpoint, "--traces", str(full)):
        client = VehicleClient.connect(endpoint, gate=GATE, timeout=30.0, traces=full)
        vehicle, end = Standstill(client, 5.0), time.monotonic() + 1.0
        while time.monotonic() < end:
            assert vehicle.step().status == "solved"
        with pytest.warns(UserWarning, match=rf"^{full}: .* could not .* \(No space left"):
            client.close()
