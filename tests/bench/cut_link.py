"""Measures how long a vehicle's steps take while the links to its replicas are cut.

    python tests/bench/cut_link.py       # as root; exit code 77 where no link can be cut

The links are those of two network namespaces (`namespaces.py`); packets are lost in silence.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from namespaces import Place, enter, missing
from rich.console import Console
from service_bench import BESIDE, GATE, Bench, line

from egp_service import VehicleClient

SKIPPED = 77
CUT = 2.6  # longer than the lease after which a silent link is closed
LONGEST = 0.1  # s; 17 ms were measured, and 5 s while requests waited for room on the link


def main() -> None:
    """Cut both links for a while, and print the longest step."""
    console = Console(soft_wrap=True)
    if reason := missing():
        console.print(f"Links cannot be cut here: {reason}")
        sys.exit(SKIPPED)
    enter()
    with TemporaryDirectory() as name:
        bench = Bench(Path(name), 1.0)
        with bench.running:
            places = [Place.make(1) for _ in range(2)]
            for r, place in enumerate(places):
                bench.serve(f"r{r}", place=place, workers=1)
            reached = [place.reached[0] for place in places]
            with VehicleClient.connect(reached, gate=GATE, timeout=30.0) as client:
                reference = line(client)

                def drive(seconds: float) -> tuple[float, int]:
                    longest, solved, until = 0.0, 0, time.monotonic() + seconds
                    while time.monotonic() < until:
                        begun = time.monotonic()
                        step = client.step(BESIDE, reference)
                        longest = max(longest, time.monotonic() - begun)
                        solved += step.status == "solved"
                        if step.mode == "stop":
                            client.reset()
                        time.sleep(max(0.0, begun + client.dt - time.monotonic()))
                    return longest, solved

                drive(2.0)
                for place in places:
                    place.cut(0)
                longest, _ = drive(CUT)
                for place in places:
                    place.cut(0, heal=True)
                _, solved = drive(4.0)
    console.print(f"longest step {1e3 * longest:.0f} ms, {solved} steps solved afterwards")
    sys.exit(0 if longest < LONGEST and solved else 1)


if __name__ == "__main__":
    main()
