"""Services, routers and vehicles in processes of their own, for `service_table.py`."""

from __future__ import annotations

import json
import math
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

import numpy as np
import zenoh
from namespaces import PORT

from egp_service import VehicleClient, shipped
from egp_service._core.testing import step_key
from egp_service.control.endpoints import why_unreachable
from egp_service.control.recorded import read_recording
from egp_service.simulation.scenario import gate_settings, load_scenario

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from namespaces import Place

EGP = [sys.executable, "-m", "egp_service"]
LIBRARIES = (shipped.DEMO_LIBRARY, shipped.DEMO_LIBRARY.with_name("evaluation-library.safetensors"))
RATE = 50.0  # requests of a vehicle in 1/s
GATE = gate_settings(load_scenario("rounded-rectangle"))
LEAST = np.array([GATE["force_min"], -GATE["steering_rate"]])
MOST = np.array([GATE["force_max"], GATE["steering_rate"]])


@dataclass
class Bench:
    """Processes of one measurement, ended with it."""

    folder: Path
    share: float
    running: ExitStack = field(default_factory=ExitStack)

    def count(self, number: float) -> int:
        """Return a number of repetitions, or of seconds, times the share that was asked for."""
        return max(1, round(number * self.share))

    def start(self, *command: str, inside: Sequence[str] = ()) -> subprocess.Popen[bytes]:
        """Start a command of `egp`, behind the words `inside`; its output goes to `log.txt`."""
        with (self.folder / "log.txt").open("a", encoding="utf-8") as log:
            process = subprocess.Popen([*inside, *EGP, *command], stdout=log, stderr=log)
        self.running.callback(process.wait)
        self.running.callback(process.kill)
        # A process that is suspended is continued first, so that it can end.
        self.running.callback(process.send_signal, signal.SIGCONT)
        return process

    def serve(
        self,
        name: str = "main",
        *,
        listen: str = "",
        route: str | Sequence[str] = "",
        place: Place | None = None,
        **options: object,
    ) -> Any:  # noqa: ANN401
        """Start a service; it listens at `listen`, or is a client of the routers at `route`.

        With a place it runs in that namespace and listens there.
        """
        reached = listen
        if place is not None:
            listen, reached = f"tcp/0.0.0.0:{PORT}", place.reached[0]
        zenoh: dict[str, object] = {"listen/endpoints": [listen] if listen else []}
        if route:
            zenoh |= {
                "mode": "client",
                "connect/endpoints": [route] if isinstance(route, str) else list(route),
                "connect/timeout_ms": 20000,
            }
        table = {"library": str(LIBRARIES[0]), "replica": name, **options}
        lines = [f"{key} = {json.dumps(value)}" for key, value in table.items()]
        lines += [
            "[zenoh]",
            *(f'"{key}" = {json.dumps(json.dumps(v))}' for key, v in zenoh.items()),
        ]
        config = self.folder / f"{name}.toml"
        config.write_text("\n".join(lines), encoding="utf-8")
        inside = () if place is None else place.inside
        process = self.start("serve", "--config", str(config), inside=inside)
        while reached and not listens_at(reached):
            if process.poll() is not None:
                raise SystemExit((self.folder / "log.txt").read_text(encoding="utf-8"))
            time.sleep(0.05)
        return process

    def recording(self) -> Path:
        """Record the demo's lap once."""
        path = self.folder.parent / "run.mcap"
        if not path.exists():
            runs = self.folder / "runs"
            subprocess.run(
                [*EGP, "drive", "--in-process", "-o", str(runs)], check=True, capture_output=True
            )
            shutil.copy(next(runs.glob("**/run.mcap")), path)
        return path

    def load(
        self, *endpoints: str, seconds: float, vehicles: int, replay: bool = True
    ) -> dict[str, Any]:
        """Run `egp load` and return its report, of the first rate if it replays."""
        result = self.folder / f"load-{time.monotonic_ns()}.json"
        # Each vehicle has a session, but not hundreds of vehicles, which take minutes to connect.
        options = ["--replay", str(self.recording()), "--sessions=64"] if replay else []
        options += [f"--connect={endpoint}" for endpoint in endpoints]
        options += [f"--seconds={seconds}", f"--vehicles={vehicles}", f"--json={result}"]
        subprocess.run([*EGP, "load", *options], check=True, capture_output=True)
        report: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
        rate: dict[str, Any] = report["rates"][0] if replay else report
        # Quantiles that fall on requests without a reply, or on refused ones, are null.
        quantiles = rate["latency_ms"]
        rate["latency_ms"] = {k: math.inf if v is None else v for k, v in quantiles.items()}
        return rate


def listens_at(endpoint: str) -> bool:
    """Return whether a process listens at the endpoint."""
    return why_unreachable(endpoint) is None


def line(client: VehicleClient) -> np.ndarray:
    """Return a straight reference at 15 m/s."""
    s = 15.0 * client.dt * np.arange(client.horizon + 1)
    return np.column_stack([s, 0.0 * s, 0.0 * s + 15.0, 0.0 * s])


# A car 0.3 m beside the line.
BESIDE = np.array([0.0, 0.3, 15.0, 0.0, 0.0, 0.0, 0.0])


@dataclass
class Driving:
    """Vehicles that drive: `vehicles` of `egp load` with plants, and one of Python on a line.

    The counts are complete after the block that `driving` opens.
    """

    vehicles: int
    python: Counter[str] = field(default_factory=Counter)
    rust: dict[str, Any] = field(default_factory=dict)

    def without_plan(self) -> int:
        """Return the number of ticks, of all vehicles, that had no new plan."""
        stopped = self.python["tail"] + self.python["stop"]
        return int(stopped + self.rust["tail_periods"] + self.rust["stop_periods"])


@contextmanager
def driving(bench: Bench, *endpoints: str, seconds: float, vehicles: int) -> Iterator[Driving]:
    """Let vehicles drive for `seconds`, in which the block must end."""
    counts, end = Driving(vehicles), Event()

    def load() -> None:
        report = bench.load(*endpoints, seconds=seconds, vehicles=vehicles, replay=False)
        counts.rust.update(report)

    def drive(client: VehicleClient) -> None:
        tail, reference = 0, line(client)
        while not end.is_set():
            begun = time.monotonic()
            step = client.step(BESIDE, reference)
            counts.python["outside limits"] += not np.all((step.u >= LEAST) & (step.u <= MOST))
            counts.python[step.mode] += 1
            tail = tail + 1 if step.mode == "tail" else 0
            counts.python["longest tail"] = max(counts.python["longest tail"], tail)
            if step.mode == "stop":
                client.reset()
            time.sleep(max(0.0, client.dt - (time.monotonic() - begun)))

    with VehicleClient.connect(endpoints, gate=GATE, timeout=30.0) as client:
        threads = [Thread(target=load), Thread(target=drive, args=(client,))]
        for thread in threads:
            thread.start()
        time.sleep(3.0)  # the vehicles of `egp load` connect
        yield counts
        threads[0].join()
        end.set()
        threads[1].join()


@contextmanager
def flood(bench: Bench, endpoint: str, vehicle: str, times: float) -> Iterator[Counter[str]]:
    """Send requests of one vehicle at `times` the rate of the control step, and count replies."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    requests = [step.request for step in read_recording(bench.recording()).steps]
    end, counts = Event(), Counter[str]()

    def count(reply: zenoh.Reply) -> None:
        counts["replies" if reply.ok is not None else "errors"] += 1

    def send() -> None:
        while not end.wait(1.0 / (RATE * times)):
            request = requests[counts["sent"] % len(requests)]
            counts["sent"] += 1
            session.get(step_key("main", "load", vehicle), count, payload=request, timeout=0.5)

    with zenoh.open(config) as session:
        thread = Thread(target=send)
        thread.start()
        yield counts
        end.set()
        thread.join()
