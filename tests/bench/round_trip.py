"""What the service adds to a bare query of zenoh: round trips, and processor time for each request.

One client in Rust asks a bare queryable, which answers with as many bytes as the service at once,
and then the service with one worker, for the same recorded request. The round trip without the step
is what is left when the time that the service states for the step is subtracted. Processor time is
that of the whole answering process. The last rows are services that write traces.

    python tests/bench/round_trip.py          # a minute; nothing else should run
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from service_bench import Bench, listens_at

from egp_service._core.testing import step_key
from egp_service.control.endpoints import free_endpoint
from egp_service.control.recorded import read_recording

ROOT = Path(__file__).parents[2]
COUNT = 5000
TICKS = os.sysconf("SC_CLK_TCK")


def built() -> str:
    """Build both ends with the profile and packages of the tests."""
    packages = ["--workspace", "--exclude", "egp-bench"]
    command = ["cargo", "build", "--release", "--locked", *packages, "--message-format=json"]
    output = subprocess.run(
        [*command, "--example", "round_trip"], cwd=ROOT, check=True, capture_output=True
    ).stdout
    for line in output.splitlines():
        artifact = json.loads(line)
        if artifact.get("target", {}).get("name") == "round_trip" and artifact.get("executable"):
            return str(artifact["executable"])
    raise SystemExit("cargo built no round_trip")


def processor_time(process: subprocess.Popen[bytes]) -> float:
    """Return the processor time of a process so far, s."""
    fields = Path(f"/proc/{process.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2]
    user, system = fields.split()[11:13]
    return (int(user) + int(system)) / TICKS


def asked(
    program: str, endpoint: str, key: str, request: Path, process: subprocess.Popen[bytes]
) -> tuple[np.ndarray, float]:
    """Return round trip, queue and step in µs (n, 3), and the processor time of a query."""
    before = processor_time(process)
    output = subprocess.run(
        [program, "ask", endpoint, key, str(request), str(COUNT)], check=True, capture_output=True
    ).stdout
    times = np.array([line.split() for line in output.decode().splitlines()], dtype=np.float64)
    return times, 1e6 * (processor_time(process) - before) / (COUNT + 200)


def main() -> None:
    """Measure and print."""
    program = built()
    with TemporaryDirectory() as folder:
        (Path(folder) / "bench").mkdir()
        bench = Bench(Path(folder) / "bench", 1.0)
        recorded = read_recording(bench.recording())
        request, reply = next(
            (step.request, step.reply) for step in recorded.steps[500:] if step.reply is not None
        )
        file = Path(folder) / "request"
        file.write_bytes(request)
        with bench.running:
            bare_at, served_at = free_endpoint(), free_endpoint()
            command = [program, "answer", bare_at, "bare", str(len(reply))]
            bare = subprocess.Popen(command)
            bench.running.callback(bare.wait)
            bench.running.callback(bare.kill)
            while not listens_at(bare_at):
                time.sleep(0.05)
            service = bench.serve(listen=served_at, workers=1)
            key = step_key("main", "bench", "car")
            rows = {
                "bare query": asked(program, bare_at, "bare", file, bare),
                "service": asked(program, served_at, key, file, service),
            }
            for name, share in (("traced", 1.0), ("unchosen", 0.0)):
                traces = str(Path(folder) / f"{name}.jsonl")
                at, key = free_endpoint(), step_key(name, "bench", "car")
                traced = bench.serve(name, listen=at, workers=1, traces=traces, traces_share=share)
                label = f"service, {100 * share:g} % of the traces"
                rows[label] = asked(program, at, key, file, traced)
    print(f"request of {len(request)} B, reply of {len(reply)} B, {COUNT} queries, µs")
    for name, (times, processor) in rows.items():
        middle, tail = np.quantile(times[:, 0], [0.5, 0.99])
        print(f"{name}: p50 {middle:.0f}, p99 {tail:.0f}, processor time {processor:.0f}")
    times, processor = rows["service"]
    step = float(np.median(times[:, 2]))
    rest, echo = np.median(times[:, 0] - times[:, 2]), np.median(rows["bare query"][0][:, 0])
    print(f"step: p50 {step:.0f}; round trip without it {rest:.0f}, {rest / echo:.2f} times bare")
    print(f"processor time of a request without its step: {processor - step:.0f}")


if __name__ == "__main__":
    main()
