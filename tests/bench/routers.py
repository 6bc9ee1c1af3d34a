"""Shows what a vehicle sees when routers are killed and frozen.

    python tests/bench/routers.py        # about three minutes

A service is a client of one or two routers, a vehicle has a link to each of them, and a router is
killed with SIGKILL and started again, or stopped with SIGSTOP and continued. The simulation's
routers (`rust/simulate/src/router.rs`) behave as this shows. For each fault the status of the
vehicle's periods is printed as time from the fault, status and number of successive periods.
"""

from __future__ import annotations

import signal
import time
from collections import Counter
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from rich.console import Console
from service_bench import BESIDE, GATE, Bench, line, listens_at

from egp_service import VehicleClient
from egp_service.control.endpoints import free_endpoint

if TYPE_CHECKING:
    import subprocess

SETTLED = 3.0  # seconds that are watched after the router is back
SHOWN = 12  # changes of the status
ONE = (
    ("kill", 0, 0.5),
    ("kill", 0, 1.5),
    ("freeze", 0, 0.3),
    ("freeze", 0, 1.0),
    ("freeze", 0, 5.0),
)
TWO = (("kill", 0, 1.5), ("kill", 1, 1.5), ("freeze", 0, 3.0), ("freeze", 1, 3.0))


def watch(folder: Path, count: int, faults: tuple[tuple[str, int, float], ...]) -> None:
    """Drive through `count` routers and print what each fault does."""
    bench = Bench(folder, 1.0)
    with bench.running:
        endpoints = [free_endpoint() for _ in range(count)]

        def start(k: int) -> subprocess.Popen[bytes]:
            others = [f"--connect={end}" for end in endpoints if end != endpoints[k]]
            return bench.start("router", f"--listen={endpoints[k]}", *others)

        routers = [start(k) for k in range(count)]
        while not all(map(listens_at, endpoints)):
            time.sleep(0.05)
        bench.serve(route=endpoints, workers=1)
        seen: list[tuple[float, str, str]] = []
        with VehicleClient.connect(endpoints, gate=GATE, timeout=30.0) as client:
            reference = line(client)

            def drive(until: float) -> None:
                while time.monotonic() < until:
                    begun = time.monotonic()
                    step = client.step(BESIDE, reference)
                    if step.mode == "stop":
                        client.reset()
                    seen.append((begun, step.status, step.detail))
                    time.sleep(max(0.0, begun + client.dt - time.monotonic()))

            drive(time.monotonic() + 2.0)
            for kind, k, length in faults:
                seen.clear()
                fault = time.monotonic()
                routers[k].send_signal(signal.SIGKILL if kind == "kill" else signal.SIGSTOP)
                drive(fault + length)
                if kind == "kill":
                    routers[k].wait()
                    routers[k] = start(k)
                    while not listens_at(endpoints[k]):
                        drive(time.monotonic() + 0.01)
                else:
                    routers[k].send_signal(signal.SIGCONT)
                back = time.monotonic()
                drive(back + SETTLED)
                show(f"{count} routers, {kind} {k}, back after {back - fault:.2f} s", fault, seen)


def show(title: str, fault: float, seen: list[tuple[float, str, str]]) -> None:
    """Print the changes of the status, and why questions were refused."""
    changes = []
    for status, periods in groupby(seen, key=lambda one: one[1]):
        same = list(periods)
        changes.append(f"{same[0][0] - fault:.2f} {status} {len(same)}")
    refused = Counter(detail for _, status, detail in seen if status == "refused")
    console = Console(soft_wrap=True)
    console.print(f"{title}: {'; '.join(changes[:SHOWN])}")
    for detail, times in refused.items():
        console.print(f"  {times} refused: {detail}")


def main() -> None:
    """Watch one router, then two."""
    with TemporaryDirectory() as name:
        watch(Path(name), 1, ONE)
        watch(Path(name), 2, TWO)


if __name__ == "__main__":
    main()
