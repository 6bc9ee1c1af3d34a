"""The client with the real service: the same bytes as in-process, and failures of the service."""

from __future__ import annotations

import os
import re
import signal
import socket
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import zenoh

from egp_service import Controller, EgpError, InvalidArgumentError, VehicleClient
from egp_service._core.testing import live_key
from egp_service.control.endpoints import free_endpoint
from egp_service.control.inbox import Inbox
from egp_service.control.network import Announcement, Network, ServiceUnreachableError
from egp_service.control.service_process import ServiceProcess
from egp_service.control.session import session_config
from egp_service.simulation.closed_loop import drive
from egp_service.simulation.scenario import gate_settings, library_path, load_scenario, told_zones
from frozen import freeze
from patience import ATTEMPTS, PATIENCE, wait_until
from standstill import Standstill

if TYPE_CHECKING:
    from collections.abc import Iterator

    from egp_service._core import Decision
    from egp_service.control.step import Measured, Step, StepController
    from egp_service.simulation.closed_loop import Run
    from egp_service.simulation.trace import Period

SCENARIO = told_zones(load_scenario("rounded-rectangle"))
LIBRARY = library_path(SCENARIO)
GATE = gate_settings(SCENARIO)
MASS = 1225.887


def test_a_service_that_accepts_and_says_nothing_takes_no_longer_than_the_timeout() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        endpoint = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
        begun = time.monotonic()
        with pytest.raises(ServiceUnreachableError):
            VehicleClient.connect(endpoint, gate=GATE, timeout=1.0)
    # zenoh alone waits for 10 s.
    assert time.monotonic() - begun < 5.0


@pytest.fixture
def service() -> Iterator[ServiceProcess]:
    with ServiceProcess(LIBRARY, {}) as running:
        yield running


class PatientClient(VehicleClient):
    """A client that gives each step more time than a busy machine needs."""

    patience = 5.0

    def _decide(self, start: float, budget: float, measured: Measured) -> Decision:
        return super()._decide(start, max(budget, self.patience), measured)


def freeze_service(service: ServiceProcess) -> None:
    process = service._process  # noqa: SLF001
    assert process is not None
    freeze(process)


def thaw_service(service: ServiceProcess) -> None:
    process = service._process  # noqa: SLF001
    assert process is not None
    process.send_signal(signal.SIGCONT)


def unreachable(endpoint: str, gate: dict[str, float], reason: str) -> ServiceUnreachableError:
    """Fail to connect for this reason, with more time if a busy machine has found no link yet."""
    for timeout in (0.5, 2.0, 8.0, 32.0):
        with pytest.raises(ServiceUnreachableError) as caught:
            VehicleClient.connect(endpoint, gate=gate, timeout=timeout)
        if re.search(reason, str(caught.value)):
            return caught.value
    raise AssertionError(str(caught.value))


def run_with(controller: StepController, count: int) -> list[Step]:
    vehicle = Standstill(controller)
    return [vehicle.step(deadline=5.0) for _ in range(count)]


def test_service_and_controller_give_the_same_bytes(service: ServiceProcess) -> None:
    with (
        Controller(LIBRARY, gate=GATE) as controller,
        VehicleClient.connect([service.endpoint], gate=GATE) as client,
    ):
        here, there = run_with(controller, 30), run_with(client, 30)
    assert [step.reply for step in there] == [step.reply for step in here]
    assert [step.request for step in there] == [step.request for step in here]
    assert [step.u.tolist() for step in there] == [step.u.tolist() for step in here]
    assert all(step.mode == "normal" for step in there)


@pytest.mark.skipif(sys.platform != "linux", reason="lists the threads of a process in /proc")
def test_vehicles_and_services_receive_with_eight_threads(service: ServiceProcess) -> None:
    """With two, closing the link to a silent process delays the answers of all others."""
    with VehicleClient.connect([service.endpoint], gate=GATE):
        assert service._process is not None  # noqa: SLF001
        for process in (os.getpid(), service._process.pid):  # noqa: SLF001
            end = time.monotonic() + PATIENCE
            names: list[str] = []
            # A thread that has just been started names itself a little later.
            while sum(name.startswith("rx-") for name in names) < 8:
                assert time.monotonic() < end, names
                threads = Path(f"/proc/{process}/task").glob("*/comm")
                names = [thread.read_text(encoding="utf-8") for thread in threads]


def test_a_lap_through_the_service_is_the_lap_in_process(service: ServiceProcess) -> None:
    with (
        Controller(LIBRARY, gate=GATE) as controller,
        PatientClient.connect([service.endpoint], gate=GATE) as client,
    ):
        here = drive(SCENARIO, controller, lambda _: None)
        there = drive(SCENARIO, client, lambda _: None)
    assert there.summary.ending.completed
    assert there.summary.deadline_misses == 0
    np.testing.assert_array_equal(there.trace.x, here.trace.x)


def test_a_service_killed_mid_lap_leads_to_tail_then_stop_within_limits(
    service: ServiceProcess,
) -> None:
    modes: list[str] = []
    inputs: list[list[float]] = []

    def kill_after_three_seconds(period: Period) -> None:
        modes.append(period.step.mode)
        inputs.append(period.step.u.tolist())
        if len(modes) == 150:
            service.kill()
            client.patience = 0.0

    with PatientClient.connect([service.endpoint], gate=GATE) as client:
        # A stop in a corner may end beside the road; the run is to go on until standstill.
        run: Run = drive(replace(SCENARIO, leave_distance=50.0), client, kill_after_three_seconds)
        dt = client.dt
    assert "stopped by the gate" in run.summary.ending.reason
    assert run.trace.x[-1, 2] < 1.0
    after = modes[150:]
    assert after == ["tail"] * after.count("tail") + ["stop"] * after.count("stop")
    assert after.count("tail") > 0
    u = np.array([[0.0, 0.0], *inputs])
    assert np.all(np.abs(np.diff(u[:, 0])) <= 60.0 * MASS * dt * (1 + 1e-9))
    assert np.all(np.abs(np.diff(u[:, 1])) <= 8.0 * dt * (1 + 1e-9))
    assert np.all((u[:, 0] >= -8.0 * MASS) & (u[:, 0] <= 6.0 * MASS))
    assert np.all(np.abs(u[:, 1]) <= 0.4)


def test_a_restarted_service_is_picked_up_after_a_reset(service: ServiceProcess) -> None:
    with VehicleClient.connect([service.endpoint], gate=GATE) as client:
        vehicle = Standstill(client)
        assert vehicle.step(deadline=5.0).mode == "normal"
        service.kill()
        for _ in range(30):
            step = vehicle.step()
        assert step.mode == "stop"
        wait_until(lambda: vehicle.step().status == "unreachable")
        service.start()
        end = time.monotonic() + PATIENCE
        while (step := vehicle.step(deadline=1.0)).status != "solved" and time.monotonic() < end:
            time.sleep(client.dt)
        assert step.status == "solved"
        assert step.mode == "stop", "STOP is latched"
        client.reset()
        assert vehicle.step(deadline=5.0).mode == "normal"


def test_without_a_service_a_step_costs_no_time(service: ServiceProcess) -> None:
    with VehicleClient.connect([service.endpoint], gate=GATE) as client:
        vehicle = Standstill(client)
        vehicle.step(deadline=5.0)
        service.kill()
        wait_until(lambda: vehicle.step().status == "unreachable")  # until the loss was noticed
        client.reset()
        steps = [vehicle.step() for _ in range(5)]
    assert all(step.mode == "waiting" for step in steps)
    assert all("no replica" in step.detail for step in steps)
    assert np.median([step.timings.total for step in steps]) < client.dt


def test_a_frozen_service_costs_no_more_than_the_deadline(service: ServiceProcess) -> None:
    deadline = 1.5  # longer than queries usually may take
    steps: list[Step] = []
    with VehicleClient.connect([service.endpoint], gate=GATE) as client:
        vehicle = Standstill(client)
        for _ in range(ATTEMPTS):  # a stall of the machine prolongs one
            assert vehicle.step(deadline=5.0).mode == "normal"
            freeze_service(service)
            steps.append(vehicle.step(deadline=deadline))
            thaw_service(service)
        service.kill()
    assert [(step.mode, step.status) for step in steps] == [("tail", "late")] * ATTEMPTS
    assert min(step.timings.total for step in steps) < deadline + 0.1  # measured: 1.501


def test_a_handler_of_a_signal_may_reset_within_a_step(service: ServiceProcess) -> None:
    with VehicleClient.connect([service.endpoint], gate=GATE) as client:
        vehicle, seen = Standstill(client), list[str]()
        vehicle.step(deadline=5.0)
        freeze_service(service)

        def handle(*_: object) -> None:
            frame = sys._getframe()  # noqa: SLF001
            if not client._is_within_step(frame):  # noqa: SLF001 - the machine may be busy
                signal.setitimer(signal.ITIMER_REAL, 0.05)
                return
            client.reset()
            with pytest.raises(EgpError, match="which a signal interrupts"):
                vehicle.step()
            seen.append("reset")

        before = signal.signal(signal.SIGALRM, handle)
        try:
            signal.setitimer(signal.ITIMER_REAL, 0.05)
            step = vehicle.step(deadline=0.5)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)
        assert (seen, step.mode, step.status) == (["reset"], "tail", "late")
        service.kill()
        assert vehicle.step(deadline=0.1).mode == "waiting", "the reset comes after the step"


def test_the_deadline_can_be_read_while_another_thread_steps() -> None:
    with Controller(LIBRARY, gate=GATE) as controller:
        vehicle, over = Standstill(controller), threading.Event()

        def steps() -> None:
            while not over.is_set():
                vehicle.step()

        stepping = threading.Thread(target=steps)
        stepping.start()
        try:
            assert {controller.deadline for _ in range(50)} == {0.8 * controller.dt}
        finally:
            over.set()
            stepping.join()


def test_a_measurement_that_is_not_finite_stops_the_vehicle() -> None:
    with Controller(LIBRARY, gate=GATE) as controller:
        vehicle = Standstill(controller)
        vehicle.step()
        step = controller.step(np.full(7, np.nan), vehicle.reference)
        assert (step.mode, step.status, step.request) == ("stop", "invalid_state", b"")
        assert np.all(np.isfinite(step.u))
        assert vehicle.step().mode == "stop"


def test_one_endpoint_may_be_a_string(service: ServiceProcess) -> None:
    with VehicleClient.connect(service.endpoint, gate=GATE) as client:
        assert Standstill(client).step(deadline=5.0).mode == "normal"


def test_a_closed_client_takes_no_step(service: ServiceProcess) -> None:
    with VehicleClient.connect(service.endpoint, gate=GATE) as client:
        vehicle = Standstill(client)
        assert vehicle.step(deadline=5.0).mode == "normal"
    with pytest.raises(EgpError, match="the controller was closed: make another one"):
        vehicle.step()


@pytest.mark.parametrize("names", [{"vehicle": "a/b"}, {"fleet": ""}, {"vehicle": "car 7"}])
def test_names_that_cannot_be_part_of_a_key_are_refused_before_connecting(
    names: dict[str, str],
) -> None:
    with pytest.raises(InvalidArgumentError, match="A-Z a-z 0-9"):
        VehicleClient.connect("tcp/127.0.0.1:9", gate=GATE, **names)  # type: ignore[arg-type]


def test_a_file_of_keys_that_is_no_text_is_named(tmp_path: Path) -> None:
    file = tmp_path / "car-1.keys"
    file.write_bytes(b"\xff\x00")
    with pytest.raises(InvalidArgumentError, match=r"car-1\.keys: expected a file of secret keys"):
        VehicleClient.connect("tcp/127.0.0.1:9", gate=GATE, key_file=file)


def test_a_gate_that_fits_no_replica_is_an_error_that_names_the_replica(
    service: ServiceProcess,
) -> None:
    wide = GATE | {"steering_rate": 0.6}
    error = unreachable(service.endpoint, wide, r"0\.6 rad/s.*0\.4 rad/s")
    assert len(error.replicas) == 1


def test_replicas_that_come_and_go_take_no_memory(service: ServiceProcess) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{service.endpoint}"]')
    with (
        VehicleClient.connect(service.endpoint, gate=GATE) as client,
        zenoh.open(config) as session,
    ):
        vehicle = Standstill(client)
        for number in range(20):
            token = session.liveliness().declare_token(live_key(f"passing-{number}"))
            vehicle.step(deadline=5.0)
            token.undeclare()  # type: ignore[no-untyped-call]
        vehicle.step(deadline=5.0)
        network = next(value for value in vars(client).values() if isinstance(value, Network))
        held = [value for value in vars(network).values() if isinstance(value, Inbox)]
    assert held
    assert sum(len(value._events) for value in held) < 20  # noqa: SLF001


def test_events_beyond_the_deadline_wait_for_the_next_step(service: ServiceProcess) -> None:
    with VehicleClient.connect(service.endpoint, gate=GATE) as client:
        vehicle = Standstill(client)
        vehicle.step(deadline=5.0)
        inbox = client._network._inbox  # noqa: SLF001
        for _ in range(1000):
            inbox.put(Announcement(time.monotonic(), "main", appeared=True))
        vehicle.step(deadline=1e-9)
        # 64 are told before the period, and one while it waits for its answer.
        assert len(inbox._events) >= 1000 - 65  # noqa: SLF001
        vehicle.step(deadline=5.0)
        assert len(inbox._events) < 20  # noqa: SLF001


def test_a_handler_of_a_signal_that_is_slow_does_not_prolong_a_wait() -> None:
    inbox: Inbox[str] = Inbox()
    late = threading.Timer(20.0, inbox.put, ["late"])
    before = signal.signal(signal.SIGALRM, lambda *_: time.sleep(0.3))
    late.start()
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        assert inbox.get(0.2) is None
    finally:
        late.cancel()
        signal.signal(signal.SIGALRM, before)
    for event in ("first", "second"):
        inbox.put(event)
    assert [inbox.get(0.0) for _ in range(3)] == ["first", "second", None]


def test_a_replica_whose_loss_is_reported_late_is_found_again(service: ServiceProcess) -> None:
    """As zenoh does it when the replica changes to another router; see `session.look_again`."""
    with VehicleClient.connect([service.endpoint], gate=GATE) as client:
        run_with(client, 1)
        network = client._network  # noqa: SLF001
        network._inbox.put(Announcement(time.monotonic(), "main", appeared=False))  # noqa: SLF001
        vehicle = Standstill(client)
        wait_until(lambda: vehicle.step(deadline=1.0).status == "solved")


def test_connecting_to_nobody_says_what_to_do() -> None:
    with pytest.raises(ServiceUnreachableError, match=r"there is no link to .*egp serve"):
        VehicleClient.connect(["tcp/127.0.0.1:9"], gate=GATE, timeout=0.5)
    endpoint = free_endpoint()
    with zenoh.open(session_config([], 1.0, {"listen/endpoints": [endpoint]})):
        unreachable(endpoint, GATE, r"^no replica of the service announces")
