"""Whether a slow vehicle that is beside its path or turned away comes back (docs/tuning.md).

The car of the demo's library begins beside a path with friction 1.1, is planned to drive at a
constant speed, and has 15 s; several values of `cost.lateral` are compared.

    python tests/bench/slow.py          # half a minute
"""

from __future__ import annotations

import sys

import numpy as np

from egp_service import Controller, Library, Path, Plant, SpeedProfile, horizon_reference, shipped

CAR = Library.load(shipped.DEMO_LIBRARY).parameters
FRICTION = 1.1
PATH = Path.rounded_rectangle().with_friction([(0.0, FRICTION)])
START = 20.0  # m along the path
SECONDS = 15.0
CLOSE = 0.2  # m
WEIGHTS = (60.0, 10.0, 3.0)
# Speed in m/s, distance to the left of the path in m, angle to the path in rad.
STARTS = (
    (1.0, 1.4, 0.0),
    (1.0, -2.5, 0.0),
    (2.0, -2.5, 0.0),
    (2.0, 0.0, 1.0),
    (2.0, 0.0, 1.5),
    (5.0, -2.5, 0.0),
    (5.0, 1.4, 0.6),
)


def end(lateral: float, speed: float, beside: float, angle: float) -> str:
    """Drive, and say where the car is in the end."""
    profile = SpeedProfile(PATH, CAR, grip=0.8, v_max=speed)
    x, y, yaw, *_ = (float(column[0]) for column in PATH.sample(np.array([START])))
    car, s = Plant(), START
    car.reset(x - beside * np.sin(yaw), y + beside * np.cos(yaw), yaw + angle, speed)
    settings = {"cost": {"lateral": lateral}}
    with Controller(shipped.DEMO_LIBRARY, settings, gate=CAR.gate_limits()) as controller:
        for _ in range(round(SECONDS / controller.dt)):
            reference, widths, found = horizon_reference(
                PATH, profile, car.vehicle_state, controller.dt, controller.horizon, s
            )
            s = found.s
            step = controller.step(car.vehicle_state, reference, widths)
            car.step(step.u, controller.dt, FRICTION)
    if abs(found.lateral) < CLOSE:
        return "on the path"
    return f"{found.lateral:.1f} m beside it at {car.vehicle_state[2]:.1f} m/s"


def main() -> None:
    """Print a row for each start."""
    sys.stdout.write("| speed | beside | turned | ")
    print(" | ".join(f"`cost.lateral` {weight:g}" for weight in WEIGHTS) + " |")
    print("|---" * (3 + len(WEIGHTS)) + "|")
    for start in STARTS:
        speed, beside, angle = start
        ends = " | ".join(end(weight, *start) for weight in WEIGHTS)
        print(f"| {speed:g} m/s | {beside:g} m | {angle:g} rad | {ends} |", flush=True)


if __name__ == "__main__":
    main()
