"""Steps that an exception ends, programs that are held up within a step, and links that are cut."""

from __future__ import annotations

import gc
import os
import signal
import time
import warnings
import weakref
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import zenoh

from egp_service import Controller, EgpError, StatusPublisher, VehicleClient
from egp_service._core import Discovery, VehicleParameters, decode_request
from egp_service._core.testing import live_key
from egp_service.control.client import _first_ready
from egp_service.control.endpoints import free_endpoint
from egp_service.control.network import Announcement, ServiceUnreachableError
from egp_service.control.service_process import ServiceProcess
from egp_service.shipped import DEMO_LIBRARY
from frozen import freeze
from patience import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from egp_service._core import Decision, Driver
    from egp_service.control.step import Measured, Step, StepController

GATE = VehicleParameters.commonroad(1).gate_limits()


@pytest.fixture
def service() -> Iterator[ServiceProcess]:
    with ServiceProcess(DEMO_LIBRARY, {}) as running:
        yield running


@pytest.fixture
def client(service: ServiceProcess) -> Iterator[VehicleClient]:
    with VehicleClient.connect(service.endpoint, gate=GATE) as connected:
        yield connected


def step(controller: StepController, p_y: float = 0.3, deadline: float = 5.0) -> Step:
    """Take a step on a straight road, `p_y` m beside its middle."""
    s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
    reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
    return controller.step([0.0, p_y, 15.0, 0.0, 0.0, 0.0, 0.0], reference, deadline=deadline)


class InterruptionError(Exception):
    """Raised within a step."""


def interrupt(*_: object) -> None:
    raise InterruptionError


def test_after_an_exception_in_a_step_the_next_one_decides_its_own_period(
    service: ServiceProcess, client: VehicleClient
) -> None:
    for _ in range(3):
        assert step(client).mode == "normal"
    process = service._process  # noqa: SLF001
    assert process is not None
    freeze(process)
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(InterruptionError):
            step(client)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    process.send_signal(signal.SIGCONT)
    time.sleep(0.5)  # the answer to the interrupted step comes
    after = step(client, p_y=-2.0)
    request = decode_request(after.request)
    assert request.x[1] == -2.0
    assert len(request.history_z) == 0, "it is not known how long the last input was applied"
    assert (after.status, len(after.late)) == ("solved", 1)


def test_a_controller_leaves_no_command_of_an_interrupted_step_behind() -> None:
    class Interrupted(Controller):
        """A controller whose third step is interrupted after its decision."""

        count = 0

        def _decide(self, start: float, budget: float, measured: Measured) -> Decision:
            decision = super()._decide(start, budget, measured)
            self.count += 1
            if self.count == 3:
                raise InterruptionError
            return decision

    with Interrupted(DEMO_LIBRARY, gate=GATE) as controller:
        step(controller)
        assert len(decode_request(step(controller).request).history_z) == 1
        with pytest.raises(InterruptionError):
            step(controller)
        assert len(decode_request(step(controller).request).history_z) == 0
        assert len(decode_request(step(controller).request).history_z) == 1


def test_whatever_place_a_signal_interrupts_the_next_step_has_a_command() -> None:
    rng = np.random.default_rng(0)
    with Controller(DEMO_LIBRARY, gate=GATE) as controller:
        step(controller)
        interrupted = 0
        before = signal.signal(signal.SIGALRM, interrupt)
        try:
            for _ in range(1500):
                try:
                    signal.setitimer(signal.ITIMER_REAL, rng.uniform(1e-5, 6e-4))
                    step(controller)
                    signal.setitimer(signal.ITIMER_REAL, 0.0)
                except InterruptionError:
                    interrupted += 1
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)
        assert interrupted > 100
        assert step(controller).mode in ("normal", "tail")


def test_a_client_that_is_no_longer_used_is_collected(service: ServiceProcess) -> None:
    client = VehicleClient.connect(service.endpoint, gate=GATE)
    assert step(client).mode == "normal"
    network = weakref.ref(client._network)  # noqa: SLF001
    session = network().session  # type: ignore[union-attr]
    del client
    gc.collect()
    assert network() is None
    session.close()


def test_a_forked_process_gets_errors_and_can_close(
    service: ServiceProcess, client: VehicleClient
) -> None:
    assert step(client).mode == "normal"
    publisher = StatusPublisher(client, free_endpoint())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a fork beside threads, which this test is about
        child = os.fork()
    if child == 0:
        try:
            with pytest.raises(EgpError, match="forked"):
                step(client)
            with pytest.raises(EgpError, match="forked"):
                VehicleClient.connect(service.endpoint, gate=GATE)
            client.close()
            publisher.close()
            os._exit(0)
        finally:
            os._exit(1)
    deadline = time.monotonic() + PATIENCE
    while (ended := os.waitpid(child, os.WNOHANG))[0] == 0:
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.05)
    assert ended[1] == 0
    publisher.close()
    assert step(client).mode == "normal"


def hold_up(
    client: VehicleClient, monkeypatch: pytest.MonkeyPatch, seconds: float, *, answered: bool
) -> list[float]:
    """Hold the next step up once, for so many seconds, which are in the list afterwards.

    If `answered`, the answer has come and is the next event. Otherwise the delay begins before the
    answer comes, and another event is found before it.
    """
    assert step(client).mode == "normal"
    time.sleep(0.5)  # the end of the first question comes, which the next step sees before its own
    network = client._network  # noqa: SLF001
    come = network.next
    slept: list[float] = []

    def next_event(patience: float) -> Callable[[Driver], None] | None:
        if slept or patience <= 0.0:
            return come(patience)
        event = come(patience) if answered else lambda _: None
        if event is not None:
            slept.append(seconds)
            time.sleep(seconds)
        return event

    monkeypatch.setattr(network, "next", next_event)
    return slept


def test_a_program_that_is_held_up_after_an_answer_has_come_does_not_drive_its_plan(
    client: VehicleClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept = hold_up(client, monkeypatch, 1.5, answered=True)  # for longer than a tail
    late = step(client, deadline=0.5)
    assert slept
    assert (late.mode, late.status) == ("stop", "solved")
    assert late.held_up > 25


def test_an_answer_that_came_in_time_counts_although_another_event_waits_before_it(
    client: VehicleClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept = hold_up(client, monkeypatch, 0.5, answered=False)
    late = step(client, deadline=0.3)
    assert slept
    assert late.status == "solved"


class CutSession:
    """A session whose link was cut: zenoh cannot close it in time."""

    def close(self) -> None:
        """Fail as zenoh does after ten seconds."""
        raise zenoh.ZError("close operation timed out")


def test_closing_a_cut_link_does_not_replace_an_exception(
    service: ServiceProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    finished: list[str] = []

    class Finishing:
        """The driver, which notes that its traces were finished."""

        def __init__(self, driver: Any) -> None:  # noqa: ANN401
            self._driver = driver

        def __getattr__(self, name: str) -> Any:  # noqa: ANN401
            return getattr(self._driver, name)

        def finish_traces(self) -> tuple[int, str | None]:
            finished.append("traces")
            return 0, None

    client = VehicleClient.connect(service.endpoint, gate=GATE)
    session = client._network.session  # noqa: SLF001
    monkeypatch.setattr(client, "_driver", Finishing(client._driver))  # noqa: SLF001
    monkeypatch.setattr(client._network, "session", CutSession())  # noqa: SLF001
    with pytest.raises(InterruptionError), client:
        interrupt()
    assert finished == ["traces"]
    session.close()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("connecting", [True, False])
def test_a_question_about_a_lost_replica_that_has_no_answer_is_asked_again(
    service: ServiceProcess,
    monkeypatch: pytest.MonkeyPatch,
    connecting: bool,  # noqa: FBT001 - a parameter
) -> None:
    with VehicleClient.connect([service.endpoint], gate=GATE) as client:
        network, asked = client._network, list[str]()  # noqa: SLF001

        def get(key: str, handler: Any, timeout: float) -> None:  # noqa: ANN401, ARG001
            asked.append(key)
            if len(asked) == 1:
                handler.callback(SimpleNamespace(ok=None))  # as zenoh does after `timeout` s

        with monkeypatch.context() as patch:
            info = SimpleNamespace(peers_zid=list, routers_zid=list)
            stub = SimpleNamespace(liveliness=lambda: SimpleNamespace(get=get), info=info)
            patch.setattr(network, "session", stub)
            network._inbox.put(Announcement(0.0, "main", appeared=False))  # noqa: SLF001
            if connecting:
                discovery = Discovery(fleet="default", vehicle="vehicle-1", gate=GATE)
                with pytest.raises(ServiceUnreachableError):
                    _first_ready(network, discovery, [], time.monotonic() + 0.2)
            while (event := network.next(0.0)) is not None:
                event(client._driver)  # noqa: SLF001
        assert asked == 2 * [live_key("main")]
