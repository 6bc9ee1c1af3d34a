"""What the pages of the documents assume to be there: files, and names of Python."""

from __future__ import annotations

import re
import shutil
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from egp_service import Controller, Plant, shipped, simulation
from egp_service.cli.credentials import write_credentials

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

ROOT = Path(__file__).parents[2]
MASS = 1225.887  # kg, of the simulated car


def make(page: str, with_ports: Callable[[str], str]) -> dict[str, object]:
    """Make the files of a page in the working folder, and return the names for its programs."""
    if page in {"monitor", "recordings"}:
        Path("softer.toml").write_text("cost.lateral = 20.0\n", encoding="utf-8")
        shutil.copy(shipped.EVALUATION_LIBRARY, "candidate.safetensors")
        return driving()
    if page == "logs":
        oval_log(Path("lvms.csv"))
    elif page == "map":
        write_credentials(Path("keys"), "default", ["car-1"], hosts=["127.0.0.1"], port=1, days=1)
        text = Path("keys/map.json5").read_text(encoding="utf-8")
        port = with_ports("127.0.0.1:7448").rpartition(":")[2]
        assert ":7448" in text
        Path("map.json5").write_text(text.replace(":7448", f":{port}"), encoding="utf-8")
    elif page == "surfaces":
        # The page says that its commands are for a checkout of the source.
        for folder in ("python", "tests"):
            Path(folder).symlink_to(ROOT / folder)
    return {}


def shortened(page: str, text: str) -> str:
    """Return the commands of a page with a twentieth of the lap that they drive."""
    command = "egp drive --in-process -o first\n"
    if page != "first-drive" or command not in text:
        return text
    scenario = Path(simulation.__file__).parent / "scenarios/rounded-rectangle.toml"
    short = re.sub(r"(?m)^laps = .*$", "", scenario.read_text(encoding="utf-8"))
    Path("short.toml").write_text(f"laps = 0.05\n{short}", encoding="utf-8")
    return text.replace(command, "egp drive -s short.toml --in-process -o first\n")


def end(names: dict[str, object]) -> None:
    """Close what `make` opened."""
    if isinstance(opened := names.get("opened"), ExitStack):
        opened.close()


def driving() -> dict[str, object]:
    """Names of a vehicle that drives straight ahead for 30 periods."""
    opened = ExitStack()
    limits = Plant().parameters.gate_limits()
    controller = opened.enter_context(Controller(shipped.DEMO_LIBRARY, gate=limits))
    s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
    reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
    return {
        "opened": opened,
        "controller": controller,
        "driving": Periods(30),
        "x": np.array([0.0, 0.2, 15.0, 0.0, 0.0, 0.0, 0.0]),
        "reference": reference,
        "widths": np.full((controller.horizon + 1, 2), 4.0),
        "time": 0.0,
    }


class Periods:
    """Is true for a number of times."""

    def __init__(self, left: int) -> None:
        """Take the number."""
        self.left = left

    def __bool__(self) -> bool:
        """Count one of them."""
        self.left -= 1
        return self.left >= 0


def oval_log(path: Path) -> None:
    """Write a log of the simulated car with the columns of docs/logs.md, 100 s at 25 Hz."""
    car, dt, rng = Plant(), 0.04, np.random.default_rng(0)
    car.reset(0.0, 0.0, 0.0, 8.0)
    rows: list[NDArray[np.float64]] = []
    for k in range(2500):
        _, _, v_x, _, v_y, omega, delta = car.vehicle_state
        force = 600.0 + 1800.0 * np.sin(0.1 * k) - 100.0 * (v_x - 12.0)
        rate = 0.12 * np.sin(0.12 * k + 1.5) - 0.5 * delta
        measured = np.array([v_x, v_y, omega]) + [0.02, 0.01, 0.001] * rng.standard_normal(3)
        rows.append(np.array([dt * k, *measured, delta, force / MASS]))
        car.step(np.array([force, rate]), dt, 1.0)
    header = "time(s),vx(m/s),vy(m/s),omega(rad/s),delta(rad),ax(m/s^2)"
    np.savetxt(path, rows, "%.9g", ",", header=header, comments="")
