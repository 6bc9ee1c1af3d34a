"""One vehicle for each transport of the driver, all with the same interface."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from signal import SIGCONT
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from conformance.replica import ScriptedReplica
from egp_service import ServiceUnreachableError, VehicleClient
from egp_service._core import (
    Decision,
    Discovery,
    Driver,
    EgpError,
    Query,
    VehicleParameters,
    decode_ready,
)
from egp_service.control.endpoints import free_endpoint
from frozen import freeze
from patience import wait_for_replicas, wait_until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from conformance.replica import Script

FLEET, VEHICLE = "conformance", "car"
GATE = VehicleParameters.commonroad(1).gate_limits() | {"max_tail_ticks": 5.0}
ROOT = Path(__file__).parents[2]
# Far longer than a healthy replica needs on a busy machine; only the order of replicas is tested.
DEADLINE = 0.5


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one period brought; `error` is set when it was not opened."""

    mode: str = ""
    status: str = ""
    replica: str = ""
    lost: bool = False
    request: bytes = field(default=b"", repr=False)
    error: str = ""


class ConnectError(EgpError):
    """A vehicle cannot connect."""


class Vehicle(Protocol):
    """A vehicle under test."""

    dt: float
    horizon: int

    def step(
        self, x: NDArray[np.float64], reference: NDArray[np.float64], deadline: float
    ) -> Outcome:
        """Drive one period."""

    def reset(self) -> None:
        """Reset the driver."""

    def hold_up(self, seconds: float) -> None:
        """Do nothing for a time."""

    def freeze(self, replica: str) -> None:
        """Stop a replica where it is."""

    def thaw(self, replica: str) -> None:
        """Let it go on."""

    def close(self) -> None:
        """Release everything."""


class InProcess:
    """The driver with replicas as plain objects; time is counted, nothing waits."""

    def __init__(self, scripts: Mapping[str, Script], patience: float) -> None:
        """Make the replicas and the driver."""
        del patience  # every replica was asked after one round
        self._replicas = {name: ScriptedReplica(faults) for name, faults in scripts.items()}
        fitting, ready = self._first_ready()
        served = decode_ready(ready)
        self.dt, self.horizon = served.dt, served.horizon
        self._driver = Driver(ready, fleet=FLEET, vehicle=VEHICLE, gate=GATE)
        for name in scripts:
            self._driver.replica_appeared(name)
        self._driver.replica_fits(fitting)
        self._frozen: dict[str, list[Callable[[], None]]] = {}
        self._open: list[tuple[float, int]] = []
        """Until when each query listens that was not answered."""
        self._now = 0.0

    def _first_ready(self) -> tuple[str, bytes]:
        discovery = Discovery(fleet=FLEET, vehicle=VEHICLE, gate=GATE)
        for name in self._replicas:
            discovery.replica_appeared(name)
        while (question := discovery.next_question()) is not None:
            name, _, _ = question
            answer = self._replicas[name].ready()
            if discovery.is_usable(name, answer, b""):
                return name, answer
        raise ConnectError(discovery.error)

    def step(
        self, x: NDArray[np.float64], reference: NDArray[np.float64], deadline: float
    ) -> Outcome:
        """Drive one period; here the deadline is always that of a real vehicle."""
        del deadline
        self._now += self.dt
        for query in [query for until, query in self._open if until <= self._now]:
            self._driver.ended(self._now, query)
        self._open = [(until, query) for until, query in self._open if until > self._now]
        due = self._now + 0.8 * self.dt
        try:
            self._driver.tick(self._now, due, x, reference)
        except EgpError as error:
            return Outcome(error=str(error))
        while True:
            action = self._driver.next_action()
            if isinstance(action, Decision):
                return Outcome(
                    action.mode, action.status, action.replica, action.lost, action.request
                )
            if action is None:
                self._now = self._driver.next_wake
                self._driver.wake(self._now)
            elif action.replica in self._frozen:
                self._open.append((self._now + action.listen, action.id))
                held = self._frozen[action.replica]
                held.append(lambda query=action: self._deliver(query))  # type: ignore[misc]
            else:
                self._deliver(action)

    def _deliver(self, query: Query) -> None:
        replica = self._replicas[query.replica]
        if query.key.endswith("/ready"):
            self._driver.replied(self._now, query.id, replica.ready(), b"")
            return
        answer = replica.answer(query.payload)
        if answer.error:
            self._driver.refused(self._now, query.id, answer.error)
        elif answer.payload:
            self._driver.replied(self._now, query.id, answer.payload, answer.attachment)
        elif answer.ended:
            self._driver.ended(self._now, query.id)
        else:
            self._open.append((self._now + query.listen, query.id))

    def reset(self) -> None:
        """Reset the driver."""
        self._driver.reset()

    def hold_up(self, seconds: float) -> None:
        """Let the time pass."""
        self._now += seconds

    def freeze(self, replica: str) -> None:
        """Hold its answers back."""
        self._frozen[replica] = []

    def thaw(self, replica: str) -> None:
        """Deliver the answers that were held back."""
        for deliver in self._frozen.pop(replica):
            deliver()

    def close(self) -> None:
        """Do nothing."""


class Processes:
    """The replicas of a vehicle on the network, each a process of its own."""

    def __init__(self, scripts: Mapping[str, Script]) -> None:
        """Start them and wait until they serve."""
        self._cleanup = ExitStack()
        folder = Path(self._cleanup.enter_context(TemporaryDirectory(prefix="egp-conformance-")))
        self.endpoints = [free_endpoint() for _ in scripts]
        self._running: dict[str, subprocess.Popen[str]] = {}
        for (name, script), endpoint in zip(scripts.items(), self.endpoints, strict=True):
            file = folder / f"{name}.json"
            file.write_text(json.dumps(script), encoding="utf-8")
            command = [sys.executable, "-m", "conformance.replica", name, endpoint, str(file)]
            self._running[name] = self._started(command)
        with self._closed_on_error():
            for process in self._running.values():
                assert process.stdout is not None
                assert process.stdout.readline().strip() == "serving"

    def _started(self, command: list[str], stdin: int | None = None) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            command, stdin=stdin, stdout=subprocess.PIPE, text=True, cwd=ROOT / "tests"
        )
        self._cleanup.enter_context(process)  # closes the pipes and waits
        self._cleanup.callback(process.kill)
        return process

    @contextmanager
    def _closed_on_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self._cleanup.close()
            raise

    def hold_up(self, seconds: float) -> None:
        """Let the time pass."""
        time.sleep(seconds)

    def freeze(self, replica: str) -> None:
        """Stop a replica as a machine does that hangs."""
        freeze(self._running[replica])

    def thaw(self, replica: str) -> None:
        """Let it go on."""
        self._running[replica].send_signal(SIGCONT)

    def close(self) -> None:
        """End them."""
        self._cleanup.close()


class OverZenohInPython(Processes):
    """`VehicleClient`."""

    def __init__(self, scripts: Mapping[str, Script], patience: float) -> None:
        """Connect to the replicas."""
        super().__init__(scripts)
        with self._closed_on_error():
            self._client = self._connected(patience)
        self.dt, self.horizon = self._client.dt, self._client.horizon
        with self._closed_on_error():
            wait_for_replicas(self._client, len(scripts))

    def _connected(self, patience: float) -> VehicleClient:
        try:
            return VehicleClient.connect(
                self.endpoints, fleet=FLEET, vehicle=VEHICLE, gate=GATE, timeout=patience
            )
        except ServiceUnreachableError as error:
            reasons = (f"replica {name}: {why}" for name, why in error.replicas.items())
            raise ConnectError("; ".join(reasons)) from error

    def step(
        self, x: NDArray[np.float64], reference: NDArray[np.float64], deadline: float
    ) -> Outcome:
        """Drive one period."""
        try:
            step = self._client.step(x, reference, deadline=deadline)
        except EgpError as error:
            return Outcome(error=str(error))
        return Outcome(step.mode, step.status, step.replica, step.lost, step.request)

    def reset(self) -> None:
        """Reset the driver."""
        self._client.reset()

    def close(self) -> None:
        """Close the client, then the replicas."""
        self._client.close()
        super().close()


class OverZenohInRust(Processes):
    """The onboard client of `clients/vehicle`, as a program."""

    def __init__(self, scripts: Mapping[str, Script], patience: float) -> None:
        """Build it, start it, and connect."""
        super().__init__(scripts)
        with self._closed_on_error():
            self._process = self._started(
                [_built_example(), str(patience), *self.endpoints], stdin=subprocess.PIPE
            )
            served = self._read()
            if "error" in served:
                raise ConnectError(served["error"])
        self.dt, self.horizon = float(served["dt"]), int(served["horizon"])
        with self._closed_on_error():
            wait_until(lambda: self._call({"replicas": True})["replicas"] >= len(scripts))

    def step(
        self, x: NDArray[np.float64], reference: NDArray[np.float64], deadline: float
    ) -> Outcome:
        """Drive one period."""
        # JSON cannot express a number that is not finite; a number beyond the domain replaces it.
        state, ahead = (np.nan_to_num(values, nan=1e300).tolist() for values in (x, reference))
        answer = self._call({"deadline": deadline, "x": state, "reference": ahead})
        if "error" in answer:
            return Outcome(error=answer["error"])
        return Outcome(
            answer["mode"],
            answer["status"],
            answer["replica"],
            answer["lost"],
            bytes(answer["request"]),
        )

    def reset(self) -> None:
        """Reset the driver."""
        self._call({"reset": True})

    def _call(self, command: object) -> dict[str, Any]:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(command) + "\n")
        self._process.stdin.flush()
        return self._read()

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "the vehicle's program has ended"
        answer: dict[str, Any] = json.loads(line)
        return answer


@cache
def _built_example() -> str:
    """Build the Rust vehicle and give the path of its program.

    Profile and packages are those of `make rust-test`, so that nothing is compiled twice.
    """
    packages = ["--workspace", "--exclude", "egp-bench"]
    command = ["cargo", "build", "--release", "--locked", *packages, "--message-format=json"]
    output = subprocess.run(
        [*command, "--example", "stdin_vehicle"], cwd=ROOT, check=True, capture_output=True
    ).stdout
    for line in output.splitlines():
        built = json.loads(line)
        if built.get("target", {}).get("name") == "stdin_vehicle" and built.get("executable"):
            return str(built["executable"])
    raise AssertionError("cargo built no stdin_vehicle")
