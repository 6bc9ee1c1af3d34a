"""Draws what single settings of the control step change, for docs/tuning.md.

    python tests/bench/tuning.py

Drives the first 40 % of the demo's lap, whose zones the reference speed is told, with measured
states that are noisy, and writes docs/tuning-NAME.png.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from egp_service.simulation.closed_loop import drive
from egp_service.simulation.in_process import in_process_controller
from egp_service.simulation.scenario import Measurement, load_scenario, told_zones

if TYPE_CHECKING:
    from egp_service.simulation.closed_loop import Run

DOCS: Final = Path(__file__).parents[2] / "docs"
NOISE: Final = Measurement(position=0.02, v_x=0.03, psi=0.002, v_y=0.03, omega=0.005)
COLOURS: Final = ("#0072B2", "#000000", "#D55E00")
ZONE: Final = 0.33  # part of the lap where the friction changes from 0.5 to 1.1
STYLES: Final = ("--", "-", ":")


@dataclass(frozen=True)
class Comparison:
    """A setting, three values of it, and what is drawn below the lateral error."""

    table: str
    key: str
    values: tuple[object, object, object]
    below: str


COMPARISONS: Final = (
    Comparison("cost", "lateral", (6.0, 60.0, 600.0), "steering rate"),
    Comparison("cost", "rate", ([0.05, 1.0], [0.05, 10.0], [0.05, 100.0]), "steering rate"),
    Comparison("", "horizon", (15, 40, 60), "steering rate"),
    Comparison("weights", "window", (5, 25, 60), "weight"),
)


def lap(comparison: Comparison, value: object) -> Run:
    """Drive with one value of the setting."""
    control: dict[str, object] = {comparison.key: value}
    if comparison.table:
        control = {comparison.table: control}
    scenario = told_zones(load_scenario("rounded-rectangle"))
    speed = replace(scenario.speed, grip=0.9)
    scenario = replace(scenario, laps=0.4, speed=speed, measurement=NOISE, control=control)
    with in_process_controller(scenario) as controller:
        return drive(scenario, controller, lambda _: None)


def draw(comparison: Comparison) -> None:
    """Write the picture of one setting."""
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(8.0, 4.6), sharex=True)
    name = f"{comparison.table}.{comparison.key}".removeprefix(".")
    for value, colour, style in zip(comparison.values, COLOURS, STYLES, strict=True):
        run = lap(comparison, value)
        trace = run.trace
        rms = 100.0 * float(np.sqrt(np.mean(trace.lateral_error**2)))
        label = f"{value}: {rms:.1f} cm RMS"
        line = {"color": colour, "linestyle": style, "linewidth": 1.1}
        top.plot(trace.distance, trace.lateral_error, label=label, **line)
        below = trace.weights[:, 0] if comparison.below == "weight" else trace.u[:, 1]
        bottom.plot(trace.distance, below, **line)
        print(f"{name} = {label}")
    for ax in (top, bottom):
        ax.axvline(ZONE * run.path.length, color="#888888", linewidth=0.8)
        ax.grid(visible=True, linewidth=0.3)
    unit = "of the member μ 0.5" if comparison.below == "weight" else "[rad/s]"
    top.set(ylabel="beside the path [m]")
    bottom.set(ylabel=f"{comparison.below}\n{unit}", xlabel="distance [m]")
    handles, labels = top.get_legend_handles_labels()
    figure.legend(handles, labels, title=name, loc="outside right upper", frameon=False)
    figure.savefig(DOCS / f"tuning-{comparison.key}.png", dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    mpl.use("Agg")
    mpl.rcParams["figure.constrained_layout.use"] = True
    for each in COMPARISONS:
        draw(each)
