"""Runs the same schedules of faults simulated and for real, and compares the outcomes.

    python tests/bench/schedules.py                  # 200 schedules, about 20 minutes
    python tests/bench/schedules.py --count 20
    python tests/bench/schedules.py --partitions     # as root

A schedule kills, freezes, restarts or drains two replicas while two vehicles drive. For real these
are processes with SIGKILL, SIGSTOP, SIGCONT and SIGTERM, and sessions of zenoh over loopback;
simulated it is `egp simulate --seed N --fault ...`, which this prints for schedules with different
outcomes. Outcomes of a vehicle: whether it stopped, and which replica answered it at the end of
each interval of more than a second without a fault that begins or ends. A schedule with different
outcomes is run for real once more, alone: a busy machine lets an answer come late, and then a
vehicle asks another replica for a while.

With `--partitions` other schedules are drawn, which also cut the link between one vehicle and one
replica: for real each replica then runs in a network namespace of its own (`namespaces.py`).
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
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory, mkdtemp
from threading import Thread
from typing import TYPE_CHECKING

from namespaces import Place, enter, missing
from rich.console import Console
from rich.progress import Progress
from service_bench import BESIDE, EGP, GATE, Bench, line

from egp_service import VehicleClient
from egp_service.control.endpoints import free_endpoint

if TYPE_CHECKING:
    from collections.abc import Callable

SECONDS = 12.0
FIRST = 2.0  # when faults begin
SETTLED = 1.0  # after the begin or end of a fault
LAST = 0.3  # of an interval, in which most answers count
# A vehicle drives on for 25 periods of 20 ms without a plan: it stops in the long faults only.
LONG, SHORT = (1.6, 2.6), (0.1, 0.25)
VEHICLES = ("car-0", "car-1")
REPLICAS = 2
KINDS = ("kill", "freeze", "restart", "drain")
LASTING = ("kill", "freeze")
# The duration of faults that have none of their own: until the replica is back.
BACK = 1.2


@dataclass(frozen=True)
class Fault:
    """A fault of a replica, in seconds from the begin of the drive."""

    kind: str
    replica: int
    begin: float
    length: float
    vehicle: int = 0
    """The vehicle whose link to the replica is cut."""

    def __str__(self) -> str:
        """Return it as `egp simulate --fault` reads it."""
        link = f"{VEHICLES[self.vehicle]}:" if self.kind == "partition" else ""
        return f"{self.kind}:{link}r{self.replica}@{self.begin:.3f}+{self.length:.3f}"

    @property
    def end(self) -> float:
        """The time when the replica is back, or about to be."""
        return self.begin + self.length


def schedule(seed: int, *, partitions: bool) -> list[Fault]:
    """Draw faults: one, two in turn, or two at once, of which the second is long or short."""
    rng = Random(seed)  # noqa: S311 - no secret
    more = ("partition",) if partitions else ()
    kinds, lasting = KINDS + more, LASTING + more

    def draw(
        begin: float, replica: int, kinds: tuple[str, ...], length: tuple[float, float]
    ) -> Fault:
        kind = rng.choice(kinds)
        takes = rng.uniform(*length) if kind in lasting else BACK
        vehicle = rng.randrange(len(VEHICLES)) if kind == "partition" else 0
        return Fault(kind, replica, begin, takes, vehicle)

    replica = rng.randrange(REPLICAS)
    shape = rng.choice(("one", "in turn", "both for long", "both for a moment"))
    if shape == "one":
        return [draw(FIRST, replica, kinds, LONG)]
    if shape == "in turn":
        first = draw(FIRST, replica, kinds, LONG)
        return [first, draw(first.end + 1.5, rng.randrange(REPLICAS), kinds, LONG)]
    # The first one lasts over all of the second.
    within = draw(
        FIRST + 1.6,
        1 - replica,
        *((lasting, LONG) if "long" in shape else (("freeze",), SHORT)),
    )
    around = Fault(rng.choice(LASTING), replica, FIRST, within.end + 1.6 - FIRST)
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
            answers = Counter(who for t, who in self.periods if end - LAST <= t < end)
            if end - begin >= SETTLED + LAST:
                found.append(answers.most_common(1)[0][0] if answers else "no period")
        return (*found, "stopped" if self.stopped else "drove on")


PERIOD = re.compile(r"^ *([\d.]+) (car-\d) (\w+) F .*, (\w+) of (\w+)$", re.MULTILINE)


def simulated(seed: int, faults: list[Fault]) -> tuple[list[str], list[Seen]]:
    """Simulate a schedule; return the command and what each vehicle saw."""
    command = ["simulate", f"--seed={seed}", f"--seconds={SECONDS}", f"--replicas={REPLICAS}"]
    command += ["--routers=0"]
    command += [f"--vehicles={len(VEHICLES)}", *(f"--fault={fault}" for fault in faults)]
    done = subprocess.run([*EGP, *command], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stdout[-2000:] + done.stderr)
    seen = {name: Seen([], stopped=False) for name in VEHICLES}
    for t, name, mode, status, replica in PERIOD.findall(done.stdout):
        seen[name].periods.append((float(t), replica if status == "solved" else "none"))
        seen[name].stopped |= mode == "Stop"
    return command, list(seen.values())


def real(folder: Path, faults: list[Fault], *, partitions: bool) -> list[Seen]:
    """Run a schedule with processes; return what each vehicle saw."""
    bench = Bench(folder, 1.0)
    with bench.running:
        if partitions:
            places = [Place.make(len(VEHICLES)) for _ in range(REPLICAS)]
            for place in places:
                bench.running.callback(place.remove)
            endpoints = [[place.reached[v] for place in places] for v in range(len(VEHICLES))]
        else:
            places = []
            endpoints = [[free_endpoint() for _ in range(REPLICAS)]] * len(VEHICLES)

        def serve(r: int) -> subprocess.Popen[bytes]:
            where = {"place": places[r]} if places else {"listen": endpoints[0][r]}
            started: subprocess.Popen[bytes] = bench.serve(f"r{r}", workers=1, **where)
            return started

        replicas = [serve(r) for r in range(REPLICAS)]
        seen = [Seen([], stopped=False) for _ in VEHICLES]
        clients = [
            VehicleClient.connect(own, fleet="fleet", vehicle=name, gate=GATE, timeout=30.0)
            for name, own in zip(VEHICLES, endpoints, strict=True)
        ]
        time.sleep(1.0)  # the vehicles see both replicas
        begun = time.monotonic()
        threads = [
            Thread(target=drive, args=(*pair, begun)) for pair in zip(clients, seen, strict=True)
        ]
        for thread in threads:
            thread.start()
        disturb(faults, begun, replicas, places, serve)
        for thread in threads:
            thread.join()
        for client in clients:
            client.close()
    return seen


def disturb(
    faults: list[Fault],
    begun: float,
    replicas: list[subprocess.Popen[bytes]],
    places: list[Place],
    serve: Callable[[int], subprocess.Popen[bytes]],
) -> None:
    """Let the faults of a drive that has begun happen to its replicas."""
    edges = [(fault.begin, False, fault) for fault in faults]
    edges += [(f.end, True, f) for f in faults if f.kind in (*LASTING, "partition")]
    for t, ends, fault in sorted(edges, key=lambda edge: edge[0]):
        time.sleep(max(0.0, begun + t - time.monotonic()))
        r = fault.replica
        if fault.kind == "partition":
            places[r].cut(fault.vehicle, heal=ends)
            continue
        if fault.kind == "freeze":
            replicas[r].send_signal(signal.SIGCONT if ends else signal.SIGSTOP)
            continue
        if not ends:
            replicas[r].send_signal(signal.SIGTERM if fault.kind == "drain" else signal.SIGKILL)
            replicas[r].wait()
        if ends or fault.kind != "kill":
            replicas[r] = serve(r)


def drive(client: VehicleClient, seen: Seen, begun: float) -> None:
    """Drive along a line, period by period."""
    reference = line(client)
    for k in range(round(SECONDS / client.dt)):
        due = begun + k * client.dt
        time.sleep(max(0.0, due - time.monotonic()))
        step = client.step(BESIDE, reference)
        seen.periods.append((due - begun, step.replica if step.reply is not None else "none"))
        seen.stopped |= step.mode == "stop"


@dataclass
class Compared:
    """A schedule and its outcomes, simulated and for real, of each vehicle."""

    faults: list[Fault]
    partitions: bool
    command: list[str]
    simulated: list[tuple[str, ...]]
    real: list[tuple[str, ...]]

    @property
    def same(self) -> bool:
        """Whether the outcomes agree."""
        return self.simulated == self.real

    def drive(self, folder: Path) -> Compared:
        """Run the schedule for real, in a new folder inside `folder`."""
        own = Path(mkdtemp(dir=folder))
        seen = real(own, self.faults, partitions=self.partitions)
        return replace(self, real=[one.outcome(self.faults) for one in seen])


def compare(seed: int, folder: Path, *, partitions: bool) -> Compared:
    """Run a schedule in both ways."""
    faults = schedule(seed, partitions=partitions)
    command, seen = simulated(seed, faults)
    outcomes = [s.outcome(faults) for s in seen]
    return Compared(faults, partitions, command, outcomes, []).drive(folder)


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=200, help="schedules")
    parser.add_argument("--first", type=int, default=0, help="seed of the first schedule")
    parser.add_argument("--jobs", type=int, default=2, help="schedules at the same time")
    parser.add_argument(
        "--partitions", action="store_true", help="also cut links, in network namespaces (root)"
    )
    options = parser.parse_args()
    if options.partitions:
        if reason := missing():
            raise SystemExit(f"no schedule was run, because links cannot be cut here: {reason}")
        enter()
    seeds = range(options.first, options.first + options.count)
    console = Console()
    with (
        TemporaryDirectory() as name,
        ThreadPoolExecutor(options.jobs) as pool,
        Progress(console=Console(stderr=True)) as progress,
    ):
        folder = Path(name)
        results = pool.map(lambda seed: compare(seed, folder, partitions=options.partitions), seeds)
        first = list(progress.track(results, total=len(seeds), description="comparing"))
        unlike = [one for one in first if not one.same]
        again = [one.drive(folder) for one in progress.track(unlike, description="comparing again")]
    for one in unlike:
        show(console, one)
    different = [one for one in again if not one.same]
    seen = Counter(part for one in first for outcome in one.real for part in outcome)
    answered = ", ".join(f"{seen[who]} by {who}" for who in ("r0", "r1", "none"))
    console.print(
        f"{len(seeds) - len(unlike)} of {len(seeds)} schedules have the same outcomes, and "
        f"{len(unlike) - len(different)} more when they were run again alone.\n"
        f"Intervals answered for real: {answered}. "
        f"{seen['stopped']} of {len(seeds) * len(VEHICLES)} vehicles stopped.",
        soft_wrap=True,
    )
    sys.exit(1 if different else 0)


def show(console: Console, one: Compared) -> None:
    """Print how to replay a schedule, and its outcomes."""
    console.print(f"egp {' '.join(one.command)}", soft_wrap=True)
    for name, a, b in zip(VEHICLES, one.simulated, one.real, strict=True):
        text = f"  {name} simulated: {', '.join(a)}; real: {', '.join(b)}"
        console.print(text, soft_wrap=True)


if __name__ == "__main__":
    main()
