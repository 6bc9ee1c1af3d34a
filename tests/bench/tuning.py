"""Draws what single settings change, for docs/tuning.md.

    python tests/bench/tuning.py [NAME ...]

Drives the first 40 % of the demo's lap with measured states that are noisy, and writes
docs/tuning-NAME.png for the settings of these names, or for all. The reference speed is told the
zones, but for `risk`, which plans it for what the control steps found. The drives of
`max_tail_ticks` and `budget` have replies that are missing or late, in simulated time.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Final

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from late_replies import LateReplies
from PIL import Image

from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.scenario import Measurement, load_scenario, told_zones

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from egp_service.control.step import StepController
    from egp_service.simulation.closed_loop import Run
    from egp_service.simulation.scenario import Scenario
    from egp_service.simulation.trace import Trace

DOCS: Final = Path(__file__).parents[2] / "docs"
NOISE: Final = Measurement(position=0.02, v_x=0.03, psi=0.002, v_y=0.03, omega=0.005)
COLOURS: Final = ("#0072B2", "#000000", "#D55E00")
ZONE: Final = 0.33  # part of the lap where the friction changes from 0.5 to 1.1
STYLES: Final = ("--", "-", ":")
COLOURS_OF_A_FILE: Final = 48
STEERING, SPEED = "steering rate\n[rad/s]", "speed [m/s]"
SPEED_ERROR, WEIGHT = "speed error [m/s]", "weight\nof the member μ 0.5"
SINCE: Final = "periods since a\nplan came in time"
PERIODS: Final = 5000  # more than a drive takes
DT: Final = 0.02  # control period of the demo's library, s
OUTAGE: Final = (8.0, 0.4)  # begin and length of the time without replies, s
DEFAULTS: Final = {"budget": 0.8, "max_tail_ticks": 25}


@dataclass(frozen=True)
class Comparison:
    """A setting, three values of it, and what is drawn below the lateral error.

    The table `speed` is that of a scenario, `client` that of a vehicle's client, and the others are
    those of the control step.
    """

    table: str
    key: str
    values: tuple[object, object, object]
    below: str = STEERING


COMPARISONS: Final = (
    Comparison("cost", "lateral", (8.0, 80.0, 800.0)),
    Comparison("cost", "rate", ([0.05, 1.0], [0.05, 10.0], [0.05, 100.0])),
    Comparison("cost", "psi", (1.0, 10.0, 1000.0)),
    Comparison("cost", "v_x", (0.02, 2.0, 200.0), SPEED_ERROR),
    Comparison("", "horizon", (20, 40, 60)),
    Comparison("weights", "window", (5, 25, 60), WEIGHT),
    Comparison("speed", "grip", (0.7, 0.9, 1.0), SPEED),
    Comparison("speed", "risk", (0.01, 0.1, 0.5), SPEED),
    Comparison("client", "max_tail_ticks", (5, 12, 25), SPEED),
    Comparison("client", "budget", (0.2, 0.5, 0.8), SINCE),
)


def lap(comparison: Comparison, value: object) -> Run:
    """Drive with one value of the setting."""
    control: dict[str, object] = {comparison.key: value}
    scenario = load_scenario("rounded-rectangle")
    if comparison.key != "risk":
        scenario = told_zones(scenario)
    speed = replace(scenario.speed, grip=0.9)
    if comparison.table == "client":
        control = {}
    elif comparison.table == "speed":
        speed, control = replace(speed, **control), {}  # type: ignore[arg-type]
    elif comparison.table:
        control = {comparison.table: control}
    scenario = replace(scenario, laps=0.4, speed=speed, measurement=NOISE, control=control)
    with controller_of(scenario, comparison, value) as controller:
        return drive(scenario, controller, lambda _: None)


def controller_of(scenario: Scenario, comparison: Comparison, value: object) -> StepController:
    """Compute the steps in this process, with the delays of the network for settings of clients."""
    if comparison.table != "client":
        return in_process_controller(scenario)
    settings = DEFAULTS | {comparison.key: value}
    return LateReplies(scenario, delays(comparison.key), **settings)  # type: ignore[arg-type]


def delays(key: str) -> list[float]:
    """Time from question to reply in each control period, s.

    For `max_tail_ticks` none comes for a while. For `budget` it takes 2 ms and a time that is
    exponentially distributed with a mean of 4 ms, as behind a service that others use.
    """
    if key == "budget":
        random = np.random.default_rng(1)
        found: list[float] = (0.002 + random.exponential(0.004, PERIODS)).tolist()
        return found
    begin, length = (round(time / DT) for time in OUTAGE)
    return [np.inf if begin <= k < begin + length else 0.0 for k in range(PERIODS)]


def since_in_time(trace: Trace) -> NDArray[np.int_]:
    """Count the periods since the last one whose plan came in time."""
    periods = np.arange(trace.status.size)
    solved = np.maximum.accumulate(np.where(trace.status == "solved", periods, 0))
    found: NDArray[np.int_] = periods - solved
    return found


def draw(comparison: Comparison) -> None:
    """Write the picture of one setting."""
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(8.0, 4.6), sharex=True)
    name = f"{comparison.table}.{comparison.key}".removeprefix("client").removeprefix(".")
    for value, colour, style in zip(comparison.values, COLOURS, STYLES, strict=True):
        run = lap(comparison, value)
        trace = run.trace
        rms = 100.0 * float(np.sqrt(np.mean(trace.lateral_error**2)))
        label = f"{value}: {rms:.1f} cm RMS, {trace.time[-1]:.1f} s"
        below = {
            STEERING: trace.u[:, 1],
            SPEED: trace.x[:, 2],
            SPEED_ERROR: trace.speed_error,
            WEIGHT: trace.weights[:, 0],
            SINCE: since_in_time(trace),
        }
        line = {"color": colour, "linestyle": style, "linewidth": 1.1}
        top.plot(trace.distance, trace.lateral_error, label=label, **line)
        bottom.plot(trace.distance, below[comparison.below], **line)
        late = np.mean(trace.status != "solved")
        print(f"{name} = {label}, {100.0 * late:.1f} % late, {run.summary.ending.reason}")
    for ax in (top, bottom):
        ax.axvline(ZONE * run.path.length, color="#888888", linewidth=0.8)
        ax.grid(visible=True, linewidth=0.3)
    top.set(ylabel="beside the path [m]")
    bottom.set(ylabel=comparison.below, xlabel="distance [m]")
    handles, labels = top.get_legend_handles_labels()
    figure.legend(handles, labels, title=name, loc="outside right upper", frameon=False)
    drawn = BytesIO()
    figure.savefig(drawn, dpi=90)
    plt.close(figure)
    # A palette makes the file a third as large.
    few = Image.open(drawn).convert("RGB").quantize(COLOURS_OF_A_FILE)
    few.save(DOCS / f"tuning-{comparison.key}.png", optimize=True)


if __name__ == "__main__":
    mpl.use("Agg")
    mpl.rcParams["figure.constrained_layout.use"] = True
    chosen = sys.argv[1:] or [each.key for each in COMPARISONS]
    for each in COMPARISONS:
        if each.key in chosen:
            draw(each)
