"""Measures what the service promises and prints one table of tests, goals and measured figures.

    python tests/bench/service_table.py                      # about 3 hours, on an idle machine
    python tests/bench/service_table.py --only load --only overload
    python tests/bench/service_table.py --share 0.02         # counts and durations times 0.02

Services, routers and vehicles are processes of their own that reach each other by zenoh over
loopback. The generators of the load share the machine's cores with the services.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from service_bench import (
    BESIDE,
    EGP,
    GATE,
    LIBRARIES,
    RATE,
    Bench,
    driving,
    flood,
    line,
    listens_at,
)

from egp_service import VehicleClient
from egp_service.control.endpoints import free_endpoint

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[2]
# What a measurement found, and whether the goal holds.
Measured = tuple[str, bool]


@dataclass(frozen=True)
class Row:
    """A promise: how it is measured, and what its goal is."""

    test: str
    goal: str
    measure: Callable[[Bench], Measured]


def command(*words: str, **environment: str) -> tuple[int, str]:
    """Run a command in the source and return its exit code and output."""
    done = subprocess.run(
        words, cwd=ROOT, env=os.environ | environment, capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout + done.stderr


def simulated(bench: Bench) -> Measured:
    """Simulate all faults mixed, each seed twice, on every core, and then the planted faults."""
    count, parts = bench.count(10_000), os.cpu_count() or 1
    bounds = [count * k // parts for k in range(parts + 1)]
    with ThreadPoolExecutor(parts) as pool:
        results = list(
            pool.map(
                lambda ends: command(*EGP, "simulate", f"--seeds={ends[0]}..{ends[1]}"),
                [(a, b) for a, b in pairwise(bounds) if a < b],
            )
        )
    said = "\n".join(output for _, output in results)
    totals = re.findall(r"^(\d+) seeds, ([\d.]+) vehicle-hours, (\d+) faults", said, re.MULTILINE)
    if not totals:
        return said[-300:], False
    seeds, hours, begun = (sum(map(float, column)) for column in zip(*totals, strict=True))
    planted, found = command(*EGP, "simulate", "--planted")
    violations = len(re.findall(r"^seed \d+: .* broken", said, re.MULTILINE))
    code = max(code for code, _ in results)
    run = f"{seeds:.0f} seeds, {hours:.1f} vehicle-hours, {begun:.0f} faults"
    last = found.strip().splitlines()[-1]
    return f"{run}: {violations} violations; {last}", not (code or planted)


def schedules(bench: Bench) -> Measured:
    """Run schedules of faults simulated and for real."""
    program = ("tests/bench/schedules.py", f"--count={bench.count(200)}")
    code, said = command(sys.executable, *program)
    lines = [line for line in said.splitlines() if "have the same outcomes" in line]
    return lines[-1] if lines else said[-300:], code == 0


def many_vehicles(bench: Bench) -> Measured:
    """Serve 48 vehicles that replay a lap."""
    endpoint = free_endpoint()
    bench.serve(listen=endpoint, workers=2)
    rate = bench.load(endpoint, seconds=bench.count(60), vehicles=48)
    missed = rate["requests"] - rate["in_deadline"]
    p99, p999 = rate["latency_ms"]["p99"], rate["latency_ms"]["p999"]
    held = missed == 0 and p99 <= 5.0 and p999 <= 10.0
    return f"{missed} of {rate['requests']} missed, p99 {p99:.1f} ms, p99.9 {p999:.1f} ms", held


def one_worker(bench: Bench) -> Measured:
    """Offer one worker 0.9 and three times what its median step time would allow."""
    endpoint = free_endpoint()
    bench.serve(listen=endpoint, workers=1)
    probe = bench.load(endpoint, seconds=5, vehicles=8)
    capacity = 1e3 / probe["service_step_ms"]["p50"]
    at = bench.load(endpoint, seconds=bench.count(20), vehicles=round(0.95 * capacity / RATE))
    over = bench.load(endpoint, seconds=bench.count(20), vehicles=round(3.0 * capacity / RATE))
    parts = [rate["in_deadline_per_second"] / capacity for rate in (at, over)]
    mean = over["in_deadline"] / over["requests"]
    least = over["least_vehicle_fraction"] / mean if mean else 0.0
    said = f"{parts[0]:.0%} of {capacity:.0f}/s; at 3 times {parts[1]:.0%}, least share {least:.0%}"
    return said, min(parts) >= 0.9 and least >= 0.8


def flooded(bench: Bench) -> Measured:
    """Compare other vehicles' p99 with and without a vehicle that floods, or is there twice."""
    endpoint = free_endpoint()
    bench.serve(listen=endpoint, workers=2)
    seconds = bench.count(20)
    quiet = bench.load(endpoint, seconds=seconds, vehicles=8)
    ratios, misses = [], []
    for vehicle, times in (("car-99", 10.0), ("car-0", 1.0)):
        with flood(bench, endpoint, vehicle, times) as counts:
            rate = bench.load(endpoint, seconds=seconds, vehicles=8)
        assert counts["replies"] > 0, "the service did not answer the vehicle that floods"
        ratios.append(rate["latency_ms"]["p99"] / quiet["latency_ms"]["p99"])
        misses.append(rate["requests"] - rate["in_deadline"])
    said = "p99 {:.2f} and {:.2f} times, {} and {} missed".format(*ratios, *misses)
    return said, max(ratios) <= 2.0 and max(misses) == 0


def faults(bench: Bench) -> Measured:
    """Kill and freeze two replicas in turn, with vehicles in Rust and in Python that drive."""
    endpoints = [free_endpoint(), free_endpoint()]
    replicas = [bench.serve(f"r{k}", listen=endpoints[k], workers=1) for k in range(2)]
    number, vehicles = bench.count(200), 2
    with driving(bench, *endpoints, seconds=4.5 * number + 5.0, vehicles=vehicles) as counts:
        for k in range(number):
            replica = replicas[k % 2]
            if k % 4 < 2:
                replica.kill()
                replica.wait()
                time.sleep(1.0)
                replicas[k % 2] = bench.serve(f"r{k % 2}", listen=endpoints[k % 2], workers=1)
            else:
                replica.send_signal(signal.SIGSTOP)
                time.sleep(1.5)
                replica.send_signal(signal.SIGCONT)
            time.sleep(2.0)
    rust, python = counts.rust, counts.python
    tails = rust["tail_periods"] / (number * vehicles), python["tail"] / number
    stops = rust["stop_periods"], python["stop"]
    said = (
        f"{number} faults; tail ticks per fault and vehicle {tails[0]:.2f} (Rust), {tails[1]:.2f} "
        f"(Python, longest {python['longest tail']}); stop ticks {stops[0]} and {stops[1]}"
    )
    held = max(tails) <= 1.0 and python["longest tail"] <= 1 and not any(stops)
    return said, held and not python["outside limits"]


def routers(bench: Bench) -> Measured:
    """Kill a router and start it again; measure the time from when it listens to a plan."""
    route = free_endpoint()
    bench.serve(route=route, workers=1)
    router = bench.start("router", "--listen", route)
    outages = []
    with VehicleClient.connect([route], gate=GATE, timeout=30.0) as client:
        reference = line(client)

        def answered() -> bool:
            step = client.step(BESIDE, reference)
            if step.mode == "stop":
                client.reset()
            time.sleep(0.01)
            return step.status == "solved"

        for _ in range(bench.count(20)):
            while not answered():
                pass
            router.kill()
            router.wait()
            while answered():
                pass
            router = bench.start("router", "--listen", route)
            while not listens_at(route):
                time.sleep(0.01)
            begun = time.monotonic()
            while not answered():
                pass
            outages.append(time.monotonic() - begun)
    return f"{len(outages)} restarts, longest outage {max(outages):.2f} s", max(outages) <= 1.0


def restarts_and_reloads(bench: Bench) -> Measured:
    """Restart two replicas in turn, and then reload libraries, while vehicles ask.

    Before that they ask undisturbed, because a machine that others use, too, misses steps itself.
    """
    endpoints = [free_endpoint(), free_endpoint()]
    file = bench.folder / "library.safetensors"
    shutil.copy(LIBRARIES[0], file)
    replicas = [
        bench.serve(f"r{k}", listen=endpoints[k], workers=1, library=str(file)) for k in range(2)
    ]
    number, vehicles = bench.count(10), 4
    with driving(bench, *endpoints, seconds=2.0 * number + 5.0, vehicles=vehicles) as undisturbed:
        time.sleep(2.0 * number)
    with driving(bench, *endpoints, seconds=4.0 * number + 5.0, vehicles=vehicles) as restarted:
        for k in range(number):
            replicas[k % 2].terminate()
            replicas[k % 2].wait()
            replicas[k % 2] = bench.serve(
                f"r{k % 2}", listen=endpoints[k % 2], workers=1, library=str(file)
            )
            time.sleep(2.0)
    with driving(bench, *endpoints, seconds=2.0 * number + 5.0, vehicles=vehicles) as reloaded:
        for k in range(number):
            beside = file.with_suffix(".new")
            shutil.copy(LIBRARIES[(k + 1) % 2], beside)
            beside.replace(file)
            for replica in replicas:
                replica.send_signal(signal.SIGHUP)
            time.sleep(2.0)
    missed = restarted.without_plan(), reloaded.without_plan()
    said = "ticks without a new plan: {} in {} restarts, {} in {} reloads; {} undisturbed"
    counts = (missed[0], number, missed[1], number, undisturbed.without_plan())
    return said.format(*counts), not any(missed)


def tests(*words: str) -> Callable[[Bench], Measured]:
    """Return a measurement that runs tests, of which each states one outcome."""

    def measure(_: Bench) -> Measured:
        code, said = command(sys.executable, "-m", "pytest", "-q", *words)
        return said.strip().splitlines()[-1], code == 0

    return measure


def fuzzed(bench: Bench) -> Measured:
    """Give each decoder randomly edited inputs."""
    number = str(bench.count(1_000_000))
    environment = {"BOLERO_RANDOM_ITERATIONS": number, "BOLERO_RANDOM_TEST_TIME_MS": "36000000"}
    cargo = ["cargo", "test", "--release", "--locked", "-p", "egp-testing", "--test", "fuzz"]
    code, said = command(*cargo, **environment)
    passed = sum(map(int, re.findall(r"(\d+) passed", said)))
    failed = sum(map(int, re.findall(r"(\d+) failed", said)))
    return f"{passed} decoders with {number} inputs each, {failed} failed", code == 0


def endurance(bench: Bench) -> Measured:
    """Answer requests, and compare memory, threads and descriptors after a tenth and at the end."""
    endpoint = free_endpoint()
    process = bench.serve(listen=endpoint, workers=2)
    vehicles, seconds = 32, bench.count(1_000_000) / (32 * RATE)

    def used() -> tuple[float, int, int]:
        status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
        fields = dict(line.split(":", 1) for line in status.splitlines())
        descriptors = len(list(Path(f"/proc/{process.pid}/fd").iterdir()))
        return int(fields["VmRSS"].split()[0]) / 1024, int(fields["Threads"]), descriptors

    # Idle threads of zenoh's pools end after 10 s.
    bench.load(endpoint, seconds=0.1 * seconds, vehicles=vehicles)
    time.sleep(15.0)
    before = used()
    rate = bench.load(endpoint, seconds=0.9 * seconds, vehicles=vehicles)
    time.sleep(15.0)
    after = used()
    memory, threads, descriptors = (
        f"{a:.0f} to {b:.0f}" for a, b in zip(before, after, strict=True)
    )
    said = (
        f"{rate['requests']} requests: {memory} MiB, threads {threads}, descriptors {descriptors}"
    )
    return said, after[0] <= 1.02 * before[0] and after[1:] <= before[1:]


FORGED = (
    "test_a_stranger_at_a_replicas_key_is_believed_without_a_key_only",
    "test_a_stray_replica_costs_a_vehicle_with_a_key_no_plan",
)
ROWS = {
    "simulation": Row("all faults mixed, simulated", "0 violations, every fault found", simulated),
    "schedules": Row("schedules, simulated and real", "same outcomes", schedules),
    "load": Row("48 vehicles at 50 Hz", "no miss, p99 5 ms, p99.9 10 ms", many_vehicles),
    "overload": Row(
        "one worker, and at 3 times its capacity", "90 % in time, least share 80 %", one_worker
    ),
    "flood": Row(
        "one vehicle asks 10 times as often as the others; two programs drive as one vehicle",
        "p99 of the others at most 2 times as large, no miss",
        flooded,
    ),
    "faults": Row("replicas killed and frozen", "1 tail tick each, no stop", faults),
    "routers": Row("router killed and started again", "outage 1 s", routers),
    "updates": Row("rolling restarts and reloads", "no missed step", restarts_and_reloads),
    "forged": Row(
        "forged, replayed, swapped replies; strangers",
        "none accepted",
        tests(*(f"tests/service/test_security.py::{name}" for name in FORGED)),
    ),
    "rights": Row(
        "rights of each identity",
        "as specified",
        tests("tests/service/test_access.py", "tests/service/test_certificates.py"),
    ),
    "decoders": Row("randomly edited inputs of each decoder", "no panic", fuzzed),
    "endurance": Row("a million requests", "no growth", endurance),
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", action="append", choices=list(ROWS), help="rows; by default all")
    parser.add_argument("--share", type=float, default=1.0, help="of the counts and durations")
    options = parser.parse_args()
    table = Table("test", "goal", "measured", "holds")
    names = options.only or list(ROWS)
    failed = 0
    with TemporaryDirectory() as folder, Progress(console=Console(stderr=True)) as progress:
        for name in progress.track(names, description="measuring"):
            row, own = ROWS[name], Path(folder) / name
            own.mkdir()
            bench = Bench(own, options.share)
            with bench.running:
                measured, held = row.measure(bench)
            failed += not held
            table.add_row(row.test, row.goal, measured, "yes" if held else "NO")
    Console(width=max(120, Console().width)).print(table)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
