"""Whether slow vehicles that start beside or turned away from a path come back (docs/tuning.md).

The car of the demo's library starts beside a path with friction 1.1 on its left, on it, or on its
right, is planned to drive at a constant speed, and has 30 s.

    python tests/bench/slow.py          # a minute
"""

from __future__ import annotations

import numpy as np

from egp_service import Controller, Library, Path, Plant, SpeedProfile, horizon_reference, shipped

CAR = Library.load(shipped.DEMO_LIBRARY).parameters
FRICTION = 1.1
PATH = Path.rounded_rectangle().with_friction([(0.0, FRICTION)])
START = 20.0  # m along the path
SECONDS = 30.0
CLOSE = 0.2  # m
STANDING = 0.2  # m/s
SPEEDS = (1.0, 2.0, 3.0, 4.0, 5.0)  # m/s
BESIDE = (1.4, 0.0, -2.5)  # m to the left of the path
TURNED = (0.0, 0.6, 1.0, 1.5)  # rad to the left of the path


def end(speed: float, beside: float, angle: float) -> tuple[float, float]:
    """Drive, and return the distance to the left of the path in m and the speed in the end."""
    profile = SpeedProfile(PATH, CAR, grip=0.8, v_max=speed)
    x, y, yaw, *_ = (float(column[0]) for column in PATH.sample(np.array([START])))
    car, s = Plant(), START
    car.reset(x - beside * np.sin(yaw), y + beside * np.cos(yaw), yaw + angle, speed)
    with Controller(shipped.DEMO_LIBRARY, gate=CAR.gate_limits()) as controller:
        for _ in range(round(SECONDS / controller.dt)):
            reference, widths, found = horizon_reference(
                PATH, profile, car.vehicle_state, controller.dt, controller.horizon, s
            )
            s = found.s
            step = controller.step(car.vehicle_state, reference, widths)
            car.step(step.u, controller.dt, FRICTION)
    return found.lateral, car.vehicle_state[2]


def ends(speed: float, angle: float) -> str:
    """Return how many of the three starts end on the path, and how many stand beside it."""
    found = [end(speed, beside, angle) for beside in BESIDE]
    back = sum(abs(lateral) < CLOSE for lateral, _ in found)
    stand = sum(abs(lateral) >= CLOSE and v_x < STANDING for lateral, v_x in found)
    return f"{back} back, {stand} stand" if stand else f"{back} back"


def main() -> None:
    """Print a row for each speed."""
    print("| speed | " + " | ".join(f"turned by {angle:g} rad" for angle in TURNED) + " |")
    print("|---" * (1 + len(TURNED)) + "|")
    for speed in SPEEDS:
        cells = " | ".join(ends(speed, angle) for angle in TURNED)
        print(f"| {speed:g} m/s | {cells} |", flush=True)


if __name__ == "__main__":
    main()
