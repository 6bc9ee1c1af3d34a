"""Requests of a car on a circle that moves exactly as a blend of at most three members predicts.

So the library may have any number of members, of which at most three have a weight that counts.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from egp_service._core import (
    Engine,
    InProcessDriver,
    Library,
    MemberData,
    VehicleParameters,
    write_library,
)

sys.path.append(str(Path(__file__).parents[1]))
from library_example import member_arrays

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

POINTS, HORIZON, WINDOW = 700, 20, 10
# The members' vehicle is simplified; its tyres reach their grip at slip angles of 0.3 rad.
SETTINGS = f"horizon = {HORIZON}\n[weights]\nwindow = {WINDOW}\n[soft]\nslip = 0.8"
SHARES = (0.5, 0.3, 0.2)
GOLDEN = 0.618  # spreads any number of members evenly over frictions, the first in their middle
RADIUS, SPEED = 60.0, 8.0
OFF_THE_CIRCLE = 1.0  # m; a car that is farther away poses other problems than those to be timed


def make_members(count: int, advance: Callable[[], object]) -> list[MemberData]:
    """Fit `count` members of 700 points, calling `advance` after each."""
    members = []
    for seed in range(count):
        friction = 0.4 + 0.8 * ((0.5 + GOLDEN * seed) % 1.0)
        arrays = member_arrays(friction, POINTS, seed, one_kernel=True)
        members.append(MemberData(**arrays))
        advance()
    return members


def write(path: Path, members: list[MemberData]) -> None:
    """Write the members as a library."""
    write_library(
        path,
        dt=0.05,
        kernel="rbf",
        vehicle="commonroad-1",
        parameters=VehicleParameters.commonroad(1),
        members=members,
        provenance={"source": "benchmark"},
    )


def blend(count: int) -> Array:
    """Weights of the true blend; the weights of members that do not exist go to the last one."""
    weights = np.zeros(count)
    for n, share in enumerate(SHARES):
        weights[min(n, count - 1)] += share
    return weights


def drive(
    path: Path,
    periods: int,
    *,
    want_sigma: bool,
    settings: str = SETTINGS,
    weights: Array | None = None,
) -> list[bytes]:
    """Drive with the library at `path`; return the requests once the window is full.

    The car moves as `weights` say, and they are what the controller starts from.
    """
    library, engine = Library.load(path), Engine(str(path), settings)
    if weights is None:
        weights = blend(len(library.members))
    driver = InProcessDriver(engine, gate=engine.vehicle.gate_limits(), want_sigma=want_sigma)
    driver.start_from(weights)
    x = np.array([0.0, -0.5, SPEED - 1.0, 0.0, 0.0, 0.1, 0.03])
    stages = np.arange(HORIZON + 1)
    requests = []
    for period in range(periods + WINDOW + 1):
        ahead = np.arctan2(x[0], RADIUS - x[1]) + SPEED * library.dt * stages / RADIUS
        place = RADIUS * np.stack([np.sin(ahead), 1.0 - np.cos(ahead)])
        reference = np.stack([*place, np.full(HORIZON + 1, SPEED), ahead], axis=1)
        decision = driver.step(1.0, x, reference, np.full((HORIZON + 1, 2), 3.0))
        if period > WINDOW:
            requests.append(decision.request)
        x = follow(library, weights, x, decision.u)
        if not abs(np.hypot(x[0], RADIUS - x[1]) - RADIUS) <= OFF_THE_CIRCLE:
            raise SystemExit(f"period {period}: the car has left the circle, state {x.round(2)}")
    return requests


def follow(library: Library, weights: Array, x: Array, u: Array) -> Array:
    """Move by eqs. (3), (10) and (11) with the members' blend."""
    z = np.array([[x[2], x[4], x[5], x[6], *u]])
    change = sum(w * library.predict(z, n)[0][0] for n, w in enumerate(weights) if w > 0.0)
    v_x, psi, v_y, omega = x[2:6]
    psi += 0.5 * library.dt * omega  # of the period's middle
    turned = [v_x * np.cos(psi) - v_y * np.sin(psi), v_x * np.sin(psi) + v_y * np.cos(psi)]
    following = x.copy()
    following[:2] += library.dt * np.array(turned)
    following[3] += library.dt * omega
    following[6] += library.dt * u[1]
    following[[2, 4, 5]] += change
    return following
