"""The monitor without a browser: what it keeps, and what its server answers."""

from __future__ import annotations

import asyncio
import http.client
import json
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import AsyncGenerator
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import pytest
import zenoh

from egp_service._core import EgpError, InvalidArgumentError, vehicle_key
from egp_service.control.endpoints import free_endpoint
from egp_service.control.messages import message_class
from egp_service.monitor import listener
from egp_service.monitor.fleet import FORGET_SECONDS, Fleet
from egp_service.monitor.web import _Refresh, allowed_hosts, bind
from monitor.conftest import MonitorProcess
from monitor.simulated_fleet import SimulatedFleet
from patience import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Iterator

NO_LISTENER: Any = None
MODES = ("normal", "tail", "stop", "waiting")


def status(mode: str = "normal", *, run: int = 1, total: float = 5.0, ended: bool = False) -> bytes:
    """Make a message with two periods, one of which missed unless the mode is normal."""
    times = message_class("PeriodTimes")
    message = message_class("VehicleStatus")(
        version=1,
        run=run,
        dt=0.05,
        deadline_ms=40.0,
        step=message_class("StepRecord")(mode=mode, replica="main", friction_mean=float("nan")),
        times=[times(total_ms=total), times(total_ms=total, missed=mode != "normal")],
        ended=ended,
    )
    payload: bytes = message.SerializeToString()
    return payload


def states(fleet: Fleet, now: float) -> dict[str, str]:
    fleet.update(now)
    rows = json.loads(fleet.snapshot(now))
    return {
        row.get("id") or row["name"]: row["state"] for row in rows["vehicles"] + rows["replicas"]
    }


def test_numbers_that_are_none_end_nothing_and_are_no_json() -> None:
    fleet = Fleet()
    message, nan = message_class("VehicleStatus").FromString(status()), float("nan")
    for dt in (nan, float("inf"), 0.0, -0.05):
        message.dt = dt
        fleet.status("f/car", message.SerializeToString(), 10.0)
    assert not fleet.vehicles
    message.dt, message.deadline_ms = 0.05, nan
    message.plan.extend([1.0, nan])
    fleet.status("f/car", message.SerializeToString(), 10.0)
    columns = {name: [0.0, nan] for name in ("left_x", "left_y", "right_x", "right_y", "friction")}
    fleet.road("f/car", message_class("VehicleRoad")(version=1, **columns).SerializeToString())
    car = fleet.vehicles["f/car"]
    assert car.road is None
    detail, _ = car.detail(0)
    json.dumps([json.loads(fleet.snapshot(10.0)), detail], allow_nan=False)
    assert "NaN" not in fleet.snapshot(10.0)


def test_a_further_vehicle_takes_one_place_of_one_that_ended_or_is_silent_longest() -> None:
    fleet = Fleet()
    for number in range(1000):
        fleet.status(f"f/{number}", status(), 10.0 + 1e-4 * number)
    fleet.status("f/7", status(ended=True), 10.5)
    fleet.status("f/new", status(), 10.6)  # none is silent yet, but one has ended
    assert "f/new" in fleet.vehicles
    assert "f/7" not in fleet.vehicles
    fleet.status("f/early", status(), 10.7)
    assert "f/early" not in fleet.vehicles
    fleet.status("f/0", status(), 60.0)
    for number in range(3):
        fleet.status(f"f/late{number}", status(), 60.1)
    assert len(fleet.vehicles) == 1000
    assert {"f/0", "f/4", "f/late0", "f/late1", "f/late2"} < fleet.vehicles.keys()
    assert not {"f/1", "f/2", "f/3"} & fleet.vehicles.keys()


def test_a_message_of_another_version_is_not_kept() -> None:
    fleet = Fleet()
    message = message_class("VehicleStatus").FromString(status())
    for version in (0, 2):
        message.version = version
        fleet.status("f/car", message.SerializeToString(), 10.0)
    assert not fleet.vehicles


def test_the_number_of_replicas_is_bounded() -> None:
    fleet = Fleet()
    for number in range(1001):
        fleet.token(f"r{number}", 10.0, appeared=True)
        fleet.load(f"l{number}", message_class("Load")(queued=1).SerializeToString(), 10.0)
    assert len(fleet.replicas) == 1000


def test_what_would_fill_the_memory_is_not_kept() -> None:
    fleet = Fleet()
    unknown = b"\xfa\x3f\x05hello"  # field 127
    fleet.status("f/car", status() + unknown, 10.0)
    car = fleet.vehicles["f/car"]
    assert b"hello" not in car.status.SerializeToString()
    message = message_class("VehicleStatus").FromString(status(run=2))
    message.step.detail = "x" * (1 << 16)
    fleet.status("f/car", message.SerializeToString(), 10.1)
    fleet.status("f/car", status(run=3) + unknown * 10_000, 10.1)
    fleet.status("f/car", status("x" * 1000, run=4), 10.1)
    fleet.status("f/other", status("hovering"), 10.1)
    assert (set(fleet.vehicles), car.status.run, car.last_seen) == ({"f/car"}, 1, 10.0)


def test_long_texts_reach_no_page() -> None:
    fleet = Fleet()
    message = message_class("VehicleStatus").FromString(status())
    message.step.replica = "r" * 60_000
    fleet.status("f/stranger", message.SerializeToString(), 10.0)
    assert not fleet.vehicles
    message.step.replica = "r" * 64
    message.step.detail, message.step.status = "d" * 20_000, "s" * 20_000
    message.members.extend(["m" * 10_000])
    fleet.status("f/car", message.SerializeToString(), 10.0)
    car = fleet.vehicles["f/car"]
    assert car.status.step.detail == "d" * 256
    # 64 + 3 * 256 characters of texts, and the numbers.
    assert len(fleet.snapshot(10.0)) + len(json.dumps(car.detail(0)[0])) < 4000


def test_samples_and_roads_take_little_memory_and_reach_the_page_as_they_came() -> None:
    fleet, message = Fleet(), message_class("VehicleStatus").FromString(status())
    message.step.weights.extend([0.25] * 64)
    payload = message.SerializeToString()
    names = ("left_x", "left_y", "right_x", "right_y", "friction")
    road = message_class("VehicleRoad")(
        version=1, **{n: [0.5 * k for k in range(25_000)] for n in names}
    )
    described = road.SerializeToString()
    fleet.status("f/car", payload, 10.0)
    tracemalloc.start()
    try:
        for number in range(600):
            fleet.status("f/car", payload, 10.1 + 0.1 * number)
        sampled, _ = tracemalloc.get_traced_memory()
        fleet.road("f/car", described)
        all_of_it, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert sampled < 600_000
    assert all_of_it - sampled < 1_100_000
    samples = fleet.vehicles["f/car"].detail(0)[0]["samples"]
    assert isinstance(samples, list)
    assert len(samples) == 600
    row = samples[-1]
    assert (row[:3], row[10], row[18:]) == ([70.0, "normal", 0.0], None, [False, [0.25] * 64])


def test_what_waits_for_the_page_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    payload, fleet = status(), Fleet()
    room = 3 * (len(payload) + 1024)
    monkeypatch.setattr(listener, "_MOST_WAITING", room)
    key = vehicle_key("f", "car")
    with listener.Listener([], []) as opened:
        receive: Any = opened._on_vehicle  # noqa: SLF001
        receive(SimpleNamespace(key_expr=key, payload=zenoh.ZBytes(bytes(1 << 20))))
        assert opened.dropped == 0, "a message that is too long takes no room"
        for dropped in (2, 4):
            for _ in range(5):
                receive(SimpleNamespace(key_expr=key, payload=zenoh.ZBytes(payload)))
            assert opened.dropped == dropped
            opened.deliver(fleet)
    assert fleet.vehicles["f/car"].sampled == 6


BROKEN = """
from egp_service.monitor.web import bind, serve

class Listener:
    def deliver(self, _):
        raise LookupError("what is wrong")

serve(Listener(), bind("127.0.0.1", 0), "127.0.0.1", lambda: None)
"""


def test_an_error_of_the_fleet_ends_the_server_and_is_told() -> None:
    command = [sys.executable, "-c", BROKEN]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert ended.returncode == 1
    assert "LookupError: what is wrong" in ended.stderr


@pytest.mark.parametrize("points", [25_000, 25_001])
def test_the_length_of_a_road_is_bounded(points: int) -> None:
    fleet = Fleet()
    fleet.status("f/car", status(), 10.0)
    names = ("left_x", "left_y", "right_x", "right_y", "friction")
    road = message_class("VehicleRoad")(version=1, **dict.fromkeys(names, [0.0] * points))
    fleet.road("f/car", road.SerializeToString())
    assert (fleet.vehicles["f/car"].road is not None) == (points == 25_000)


@pytest.mark.parametrize("mode", MODES)
def test_a_vehicle_has_the_state_of_its_newest_message_until_it_is_silent(mode: str) -> None:
    fleet = Fleet()
    fleet.status("f/car", status(mode), 10.0)
    assert states(fleet, 10.9) == {"f/car": mode}
    assert states(fleet, 11.1) == {"f/car": "silent"}
    fleet.status("f/car", status(ended=True), 12.0)
    assert states(fleet, 50.0) == {"f/car": "ended"}
    assert states(fleet, 12.1 + FORGET_SECONDS) == {}
    assert [event["state"] for event in fleet.events][-2:] == ["silent", "ended"]


def test_a_long_control_period_is_no_silence() -> None:
    fleet, message = Fleet(), message_class("VehicleStatus").FromString(status())
    message.dt = 1.0
    fleet.status("f/car", message.SerializeToString(), 10.0)
    assert states(fleet, 12.9) == {"f/car": "normal"}
    assert states(fleet, 13.1) == {"f/car": "silent"}


def test_a_minute_of_short_periods_is_kept() -> None:
    fleet, message = Fleet(), message_class("VehicleStatus").FromString(status())
    message.dt = 0.005
    message.times.extend([message.times[0]] * 18)
    for number in range(601):
        fleet.status("f/car", message.SerializeToString(), 0.1 * number)
    (row,) = json.loads(fleet.snapshot(60.1))["vehicles"]
    assert row["periods"] == 12_000


def test_misses_and_the_quantile_count_every_period_of_this_run() -> None:
    fleet = Fleet()
    for i in range(99):
        fleet.status("f/car", status(), float(i))
    fleet.status("f/car", status("tail", total=90.0), 99.0)
    (row,) = json.loads(fleet.snapshot(99.0))["vehicles"]
    assert (row["misses"], row["periods"], row["p99"]) == (1, 200, pytest.approx(5.0, abs=2.0))
    fleet.status("f/car", status(run=2), 99.1)
    (row,) = json.loads(fleet.snapshot(99.2))["vehicles"]
    assert (row["misses"], row["periods"]) == (0, 2)


def test_a_replica_is_silent_without_load_and_gone_without_token() -> None:
    fleet, load = Fleet(), message_class("Load")(workers=2, busy=1, step_us=1500)
    fleet.token("main", 0.0, appeared=True)
    fleet.load("main", load.SerializeToString(), 1.0)
    assert states(fleet, 2.0) == {"main": "serving"}
    assert states(fleet, 2.5) == {"main": "silent"}
    fleet.token("main", 3.0, appeared=False)
    assert states(fleet, 3.0) == {"main": "gone"}
    (row,) = json.loads(fleet.snapshot(3.0))["replicas"]
    assert (row["workers"], row["step_ms"]) == (2, 1.5)


def test_a_replica_is_silent_after_three_of_its_own_intervals() -> None:
    fleet, load = Fleet(), message_class("Load")(workers=2).SerializeToString()
    fleet.token("main", 0.0, appeared=True)
    for time_of_load in (1.0, 5.0):
        fleet.load("main", load, time_of_load)
    assert states(fleet, 16.9) == {"main": "serving"}
    assert states(fleet, 17.1) == {"main": "silent"}
    # The time in which it was away is no interval.
    fleet.token("main", 18.0, appeared=False)
    fleet.token("main", 100.0, appeared=True)
    fleet.load("main", load, 100.5)
    assert states(fleet, 101.7) == {"main": "serving"}
    assert states(fleet, 101.8) == {"main": "silent"}
    fleet.load("main", load, 110.0 + FORGET_SECONDS)
    assert states(fleet, 110.0 + 2 * FORGET_SECONDS) == {"main": "serving"}
    # Its token is there.
    assert states(fleet, 110.1 + 2 * FORGET_SECONDS) == {"main": "silent"}
    fleet.token("main", 120.0 + 2 * FORGET_SECONDS, appeared=False)
    assert states(fleet, 120.0 + 3 * FORGET_SECONDS) == {"main": "gone"}
    assert states(fleet, 120.1 + 3 * FORGET_SECONDS) == {}


def test_a_replica_that_never_had_a_token_is_forgotten() -> None:
    fleet = Fleet()
    fleet.load("main", message_class("Load")(workers=2).SerializeToString(), 0.0)
    assert states(fleet, FORGET_SECONDS) == {"main": "silent"}
    assert states(fleet, FORGET_SECONDS + 0.1) == {}


def test_bytes_that_are_no_message_change_nothing() -> None:
    fleet = Fleet()
    fleet.status("f/car", status(), 0.0)
    fleet.status("f/car", b"\xff\xff", 5.0)
    fleet.status("f/other", b"\xff\xff", 5.0)
    fleet.load("main", b"\xff\xff", 5.0)
    fleet.road("f/car", b"\xff\xff")
    assert states(fleet, 0.5) == {"f/car": "normal"}


@pytest.fixture(scope="module")
def monitor() -> Iterator[MonitorProcess]:
    found = MonitorProcess(free_endpoint())  # nothing listens there
    found.start()
    yield found
    assert found.end(signal.SIGTERM) == 0


def request(monitor: MonitorProcess, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection(urlsplit(monitor.url).netloc, timeout=PATIENCE)
    connection.request("GET", path, headers={"Connection": "close", **headers})
    return connection.getresponse()


def test_a_published_vehicle_reaches_the_stream_with_its_road(monitor: MonitorProcess) -> None:
    fleet = SimulatedFleet(monitor.listen, 1, laps=0.02)
    end = time.monotonic() + PATIENCE
    found: dict[str, object] = {}
    with request(monitor, "/events?vehicle=default/car-1") as answer:
        stream = (json.loads(line[6:]) for line in answer if line.startswith(b"data: "))
        while not {"road", "samples"} <= found.keys():
            tick = iter((True, True, True, True, True, False))
            fleet.publish(lambda tick=tick: next(tick))  # type: ignore[misc]
            found |= next(stream).get("detail", {})
            assert time.monotonic() < end
        fleet.close()
        while next(stream)["fleet"]["vehicles"][0]["state"] != "ended":
            assert time.monotonic() < end
    road = found["road"]
    assert isinstance(road, dict)
    assert len(road["left_x"]) == len(road["friction"]) > 100


def test_the_server_forbids_foreign_content_and_foreign_names(monitor: MonitorProcess) -> None:
    with request(monitor, "/") as answer:
        assert answer.status == http.HTTPStatus.OK
        assert "default-src 'self'" in (answer.getheader("content-security-policy") or "")
        assert b"http" not in answer.read()
    with request(monitor, "/", Host="elsewhere.example") as answer:
        assert answer.status == http.HTTPStatus.BAD_REQUEST


@pytest.mark.parametrize(
    ("host", "address", "elsewhere"),
    [
        ("127.0.0.1", "127.0.0.1", False),
        ("127.0.0.2", "127.0.0.2", False),
        ("own-name", "127.0.1.1", False),
        ("::1", "::1", False),
        ("0.0.0.0", "0.0.0.0", True),  # noqa: S104 - an address to be told from the others
        ("::", "::", True),
        ("192.0.2.1", "192.0.2.1", True),
    ],
)
def test_only_a_page_of_this_machine_has_names(
    host: str,
    address: str,
    elsewhere: bool,  # noqa: FBT001 - a parameter
) -> None:
    found = allowed_hosts(host, address)
    assert ("*" in found) == elsewhere
    assert elsewhere or {host, address, "localhost"} <= set(found)


def test_a_page_that_leaves_at_once_is_not_counted() -> None:
    async def visit() -> int:
        refresh = _Refresh(NO_LISTENER, lambda: False)
        stream = refresh.stream("")
        assert isinstance(stream, AsyncGenerator)
        assert (await anext(stream)).startswith("retry: ")
        await stream.aclose()
        return refresh._pages  # noqa: SLF001

    assert asyncio.run(visit()) == 0


def test_addresses_that_cannot_be_used_are_named() -> None:
    with bind("127.0.0.1", 0) as taken, pytest.raises(EgpError, match="--port"):
        bind("127.0.0.1", taken.getsockname()[1])
    with pytest.raises(EgpError, match="the host of the page is empty: give --host an address"):
        bind("", 0)
    with pytest.raises(InvalidArgumentError, match="did you mean"):
        SimulatedFleet("127.0.0.1:7449", 1, laps=0.02)
