"""What more drive in a bend does to the yaw rate: the simulated car, and the models of it.

    python tests/bench/force_effect.py [LIBRARY]

A car drives at 12 m/s on a circle that asks for 80 % of the friction. Then its steering angle is
held, and it is driven on twice, with more and with less force. The same is computed by the models
of the member of this friction. The table has the difference of the yaw rates in mrad/s for each kN.
In the last row of each friction the Gaussian processes predict lateral speed and yaw rate as if the
force had not changed.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

import egp_service
from egp_service._core import Library, Plant
from egp_service.evaluation import baselines
from egp_service.quantities import GP_INPUT, MOTION, NY, OMEGA, V_X, gp_input

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

SHIPPED: Final = Path(egp_service.__file__).parent / "shipped" / "evaluation-library.safetensors"
MEMBERS: Final = range(4)  # frictions 0.5, 0.6, 0.9 and 1.1 in the shipped library
SPEED: Final = 12.0  # m/s
LATERAL: Final = 0.8 * 9.81  # m/s² for a friction coefficient of 1
SETTLING: Final = 200  # periods
AFTER: Final = (1, 5, 15, 25)  # periods
FORCE: Final = list(GP_INPUT).index("F_x")
YAW_RATE: Final = MOTION.index(OMEGA)


def main() -> None:
    """Print the table."""
    source = Path(sys.argv[1]) if len(sys.argv) > 1 else SHIPPED
    library = Library.load(source)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fitted.safetensors"
        baselines.write(path, "fitted", source, MEMBERS, 1)
        fitted = Library.load(path)
    print("| friction | model |", *(f"{n * library.dt:.2f} s |" for n in AFTER))
    print("|---" * (2 + len(AFTER)) + "|")
    for member in MEMBERS:
        friction = library.members[member].friction
        for name, effects in compare(library, fitted, member, friction).items():
            print(f"| {friction} | {name} |", *(f"{effects[n - 1]:+.1f} |" for n in AFTER))


def compare(
    library: Library, fitted: Library, member: int, friction: float
) -> dict[str, NDArray[np.float64]]:
    """Return the effect of the force on the yaw rate after each period, mrad/s for each kN."""
    plant, force = on_a_circle(friction, library.dt)
    state, hidden = plant.vehicle_state, plant.state
    step = 100.0 * friction  # N

    def vehicle(z: NDArray[np.float64]) -> NDArray[np.float64]:
        change: NDArray[np.float64] = fitted.predict_mean(z[None], member)[0]
        return change

    def learned(z: NDArray[np.float64]) -> NDArray[np.float64]:
        change: NDArray[np.float64] = library.predict_mean(z[None], member)[0]
        return change

    def with_present_force(z: NDArray[np.float64]) -> NDArray[np.float64]:
        present = z.copy()
        present[FORCE] = force
        lateral = vehicle(z) + learned(present) - vehicle(present)
        return np.array([learned(z)[0], *lateral[1:]])

    def simulated(applied: float) -> list[float]:
        plant.state = hidden
        found = []
        for _ in range(max(AFTER)):
            plant.step([applied, 0.0], library.dt, friction)
            found.append(plant.vehicle_state[OMEGA])
        return found

    def predicted(
        model: Callable[[NDArray[np.float64]], NDArray[np.float64]], applied: float
    ) -> list[float]:
        z, found = gp_input(state, np.array([applied, 0.0])), []
        for _ in range(max(AFTER)):
            z[:NY] += model(z)
            found.append(z[YAW_RATE])
        return found

    def effect(drive: Callable[[float], list[float]]) -> NDArray[np.float64]:
        more, less = (np.array(drive(force + sign * step)) for sign in (1.0, -1.0))
        found: NDArray[np.float64] = 1e6 * (more - less) / (2.0 * step)
        return found

    return {
        "simulated car": effect(simulated),
        "fitted vehicle": effect(lambda applied: predicted(vehicle, applied)),
        "with Gaussian processes": effect(lambda applied: predicted(learned, applied)),
        "with those at the present force": effect(
            lambda applied: predicted(with_present_force, applied)
        ),
    }


def on_a_circle(friction: float, dt: float) -> tuple[Plant, float]:
    """Return the simulated car in a steady bend, and the force that holds its speed there, N."""
    yaw_rate = LATERAL * friction / SPEED
    plant, total, force = Plant(1), 0.0, 0.0
    axles = plant.parameters.l_f + plant.parameters.l_r
    plant.reset(0.0, 0.0, 0.0, SPEED, yaw_rate=yaw_rate, delta=axles * yaw_rate / SPEED)
    for _ in range(SETTLING):
        x = plant.vehicle_state
        total += (SPEED - x[V_X]) * dt
        force = plant.mass * (4.0 * (SPEED - x[V_X]) + 2.0 * total)
        plant.step([force, np.clip(0.8 * (yaw_rate - x[OMEGA]), -0.2, 0.2)], dt, friction)
    return plant, float(force)


if __name__ == "__main__":
    main()
