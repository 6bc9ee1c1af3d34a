"""Runs the same schedules of faults simulated and for real, and compares the outcomes.

    python tests/bench/schedules.py                  # 200 schedules, about 15 minutes
    python tests/bench/schedules.py --count 20

A schedule kills, freezes, restarts or drains two replicas while two vehicles drive. For real these
are processes with SIGKILL, SIGSTOP, SIGCONT and SIGTERM, and sessions of zenoh over loopback;
simulated it is `egp simulate --seed N --fault ...`, which this prints for schedules with different
outcomes. Outcomes of a vehicle: whether it stopped, and which replica answered most of its periods
in each interval without a fault that begins or ends, from a second after the last one did.
"""

from __future__ import annotations

import argparse
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from threading import Thread

from rich.console import Console
from rich.progress import Progress
from service_bench import BESIDE, EGP, GATE, Bench, free_endpoint, line

from egp_service import VehicleClient

SECONDS = 10.0
FIRST = 2.0  # when faults begin
SETTLED = 1.0  # after the begin or end of a fault
# A vehicle drives on for 25 periods of 20 ms without a plan: it stops in the long faults only.
LONG, SHORT = (1.6, 2.6), (0.1, 0.25)
VEHICLES = ("car-0", "car-1")
REPLICAS = 2
KINDS = ("kill", "freeze", "restart", "drain")
# The duration of faults that have none of their own: until the replica is back.
BACK = 1.2


@dataclass(frozen=True)
class Fault:
    """A fault of a replica, in seconds from the begin of the drive."""

    kind: str
    replica: int
    begin: float
    length: float

    def __str__(self) -> str:
        """Return it as `egp simulate --fault` reads it."""
        return f"{self.kind}:r{self.replica}@{self.begin:.3f}+{self.length:.3f}"

    @property
    def end(self) -> float:
        """The time when the replica is back, or about to be."""
        return self.begin + self.length


def schedule(seed: int) -> list[Fault]:
    """Draw faults: one, two in turn, or two at once, of which the second is long or short."""
    rng = Random(seed)  # noqa: S311 - no secret

    def draw(
        begin: float, replica: int, kinds: tuple[str, ...], length: tuple[float, float]
    ) -> Fault:
        kind = rng.choice(kinds)
        takes = rng.uniform(*length) if kind in {"kill", "freeze"} else BACK
        return Fault(kind, replica, begin, takes)

    replica = rng.randrange(REPLICAS)
    shape = rng.choice(("one", "in turn", "both for long", "both for a moment"))
    if shape == "one":
        return [draw(FIRST, replica, KINDS, LONG)]
    if shape == "in turn":
        first = draw(FIRST, replica, KINDS, LONG)
        return [first, draw(first.end + 1.5, rng.randrange(REPLICAS), KINDS, LONG)]
    # The first one lasts over all of the second.
    within = draw(
        FIRST + 1.6,
        1 - replica,
        *((("kill", "freeze"), LONG) if "long" in shape else (("freeze",), SHORT)),
    )
    around = Fault(rng.choice(("kill", "freeze")), replica, FIRST, within.end + 1.6 - FIRST)
    return [around, within]


@dataclass
class Seen:
    """When and by which replica a vehicle's periods were answered, and whether it stopped."""

    periods: list[tuple[float, str]]
    stopped: bool

    def outcome(self, faults: list[Fault]) -> tuple[str, ...]:
        """Return who answered in each settled interval, and whether the vehicle stopped."""
        edges = sorted({0.0, SECONDS, *(t for fault in faults for t in (fault.begin, fault.end))})
        found = []
        for begin, end in pairwise(edges):
            answers = Counter(who for t, who in self.periods if begin + SETTLED <= t < end)
            if end - begin >= SETTLED + 0.3:
                found.append(answers.most_common(1)[0][0] if answers else "no period")
        return (*found, "stopped" if self.stopped else "drove on")


PERIOD = re.compile(r"^ *([\d.]+) (car-\d) (\w+) F .*, (\w+) of (\w+)$", re.MULTILINE)


def simulated(seed: int, faults: list[Fault]) -> tuple[list[str], list[Seen]]:
    """Simulate a schedule; return the command and what each vehicle saw."""
    command = ["simulate", f"--seed={seed}", f"--seconds={SECONDS}", f"--replicas={REPLICAS}"]
    command += [f"--vehicles={len(VEHICLES)}", *(f"--fault={fault}" for fault in faults)]
    done = subprocess.run([*EGP, *command], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stdout[-2000:] + done.stderr)
    seen = {name: Seen([], stopped=False) for name in VEHICLES}
    for t, name, mode, status, replica in PERIOD.findall(done.stdout):
        seen[name].periods.append((float(t), replica if status == "solved" else "none"))
        seen[name].stopped |= mode == "Stop"
    return command, list(seen.values())


def real(folder: Path, faults: list[Fault]) -> list[Seen]:
    """Run a schedule with processes; return what each vehicle saw."""
    bench = Bench(folder, 1.0)
    with bench.running:
        endpoints = [free_endpoint() for _ in range(REPLICAS)]
        replicas = [bench.serve(f"r{r}", listen=endpoints[r], workers=1) for r in range(REPLICAS)]
        seen = [Seen([], stopped=False) for _ in VEHICLES]
        clients = [
            VehicleClient.connect(endpoints, fleet="fleet", vehicle=name, gate=GATE, timeout=30.0)
            for name in VEHICLES
        ]
        time.sleep(1.0)  # the vehicles see both replicas
        begun = time.monotonic()
        threads = [
            Thread(target=drive, args=(*pair, begun)) for pair in zip(clients, seen, strict=True)
        ]
        for thread in threads:
            thread.start()
        edges = [(fault.begin, False, fault) for fault in faults]
        edges += [(fault.end, True, fault) for fault in faults if fault.kind in {"kill", "freeze"}]
        for t, ends, fault in sorted(edges, key=lambda edge: edge[0]):
            time.sleep(max(0.0, begun + t - time.monotonic()))
            r = fault.replica
            if fault.kind == "freeze":
                replicas[r].send_signal(signal.SIGCONT if ends else signal.SIGSTOP)
                continue
            if not ends:
                replicas[r].send_signal(signal.SIGTERM if fault.kind == "drain" else signal.SIGKILL)
                replicas[r].wait()
            if ends or fault.kind != "kill":
                replicas[r] = bench.serve(f"r{r}", listen=endpoints[r], workers=1)
        for thread in threads:
            thread.join()
        for client in clients:
            client.close()
    return seen


def drive(client: VehicleClient, seen: Seen, begun: float) -> None:
    """Drive along a line, period by period."""
    reference = line(client)
    for k in range(round(SECONDS / client.dt)):
        due = begun + k * client.dt
        time.sleep(max(0.0, due - time.monotonic()))
        step = client.step(BESIDE, reference)
        seen.periods.append((due - begun, step.replica if step.reply is not None else "none"))
        seen.stopped |= step.mode == "stop"


def compare(
    seed: int, folder: Path
) -> tuple[list[str], list[tuple[str, ...]], list[tuple[str, ...]]]:
    """Run a schedule in both ways; return the command of the simulated one, and the outcomes."""
    faults = schedule(seed)
    own = folder / str(seed)
    own.mkdir()
    command, ours = simulated(seed, faults)
    return (
        command,
        [s.outcome(faults) for s in ours],
        [s.outcome(faults) for s in real(own, faults)],
    )


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=200, help="schedules")
    parser.add_argument("--first", type=int, default=0, help="seed of the first schedule")
    parser.add_argument("--jobs", type=int, default=3, help="schedules at the same time")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.count)
    different = 0
    seen: Counter[str] = Counter()
    console = Console()
    with (
        TemporaryDirectory() as folder,
        ThreadPoolExecutor(options.jobs) as pool,
        Progress(console=Console(stderr=True)) as progress,
    ):
        results = pool.map(lambda seed: compare(seed, Path(folder)), seeds)
        for command, ours, theirs in progress.track(
            results, total=len(seeds), description="comparing"
        ):
            seen.update(part for outcome in theirs for part in outcome)
            if ours != theirs:
                different += 1
                console.print(f"egp {' '.join(command)}", soft_wrap=True)
                for name, a, b in zip(VEHICLES, ours, theirs, strict=True):
                    console.print(
                        f"  {name} simulated: {', '.join(a)}; real: {', '.join(b)}", soft_wrap=True
                    )
    console.print(f"{len(seeds) - different} of {len(seeds)} schedules have the same outcomes")
    answered = ", ".join(f"{seen[who]} by {who}" for who in ("r0", "r1", "none"))
    console.print(
        f"Intervals answered for real: {answered}. Of {len(seeds) * len(VEHICLES)} vehicles "
        f"{seen['stopped']} stopped."
    )
    sys.exit(1 if different else 0)


if __name__ == "__main__":
    main()
