"""Measures the processor share of `egp monitor` and of a browser that shows it, on Linux.

    python tests/bench/live_page.py --vehicles 50 --seconds 20

The vehicles publish from this process, whose share is not counted.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parents[1]))

from monitor.simulated_fleet import SimulatedFleet

TICKS = os.sysconf("SC_CLK_TCK")
LISTEN, PORT = "tcp/127.0.0.1:7469", 8669
VIEW = {"width": 1500, "height": 1000}
SETTLE = 8.0


def stat(process: int) -> tuple[str, int, float]:
    """Read name, parent and processor time in s of a process from /proc."""
    text = Path(f"/proc/{process}/stat").read_text(encoding="utf-8")
    name, _, rest = text.partition("(")[2].rpartition(")")
    fields = rest.split()
    return name, int(fields[1]), (int(fields[11]) + int(fields[12])) / TICKS


def browsers() -> list[int]:
    """Find the processes of Chromium below this process."""
    parents, names = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                names[int(entry.name)], parents[int(entry.name)], _ = stat(int(entry.name))
            except OSError:
                continue  # it has ended
    found = []
    for process in parents:
        ancestor = process
        while ancestor in parents and ancestor != os.getpid():
            ancestor = parents[ancestor]
        if ancestor == os.getpid() and names[process].startswith("chrom"):
            found.append(process)
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=20.0)
    chosen = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    command = [sys.executable, "-m", "egp_service", "monitor"]
    monitor = subprocess.Popen([*command, "--listen", LISTEN, "--port", str(PORT)])
    fleet = SimulatedFleet(LISTEN, chosen.vehicles, laps=1.0)
    going_on = True
    publisher = threading.Thread(target=fleet.publish, args=[lambda: going_on])
    publisher.start()
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=chromium, args=["--no-sandbox"] if os.geteuid() == 0 else []
            )
            page = browser.new_page(viewport=VIEW)  # type: ignore[arg-type]
            page.goto(f"http://127.0.0.1:{PORT}")
            page.locator("#rows tr").nth(chosen.vehicles - 1).wait_for(state="attached")
            page.wait_for_timeout(1e3 * SETTLE)
            groups = {"egp monitor": [monitor.pid], "Chromium": browsers()}
            before = {name: sum(stat(p)[2] for p in group) for name, group in groups.items()}
            began = time.monotonic()
            page.wait_for_timeout(1e3 * chosen.seconds)
            spent = time.monotonic() - began
            for name, group in groups.items():
                share = (sum(stat(p)[2] for p in group) - before[name]) / spent
                print(f"{name:12} {100 * share:5.1f} % of a core, {chosen.vehicles} vehicles")
            browser.close()
    finally:
        going_on = False
        publisher.join()
        fleet.close()
        monitor.terminate()
        monitor.wait()


if __name__ == "__main__":
    main()
