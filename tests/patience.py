"""Waits for what a busy machine does late, and repeats what a stall of it may have spoiled."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from egp_service._core import LIVE_KEYS

if TYPE_CHECKING:
    from collections.abc import Callable

    from egp_service import VehicleClient

PATIENCE = 60.0
ATTEMPTS = 3


def wait_until(condition: Callable[[], object], patience: float = PATIENCE) -> None:
    """Return once the condition holds, and fail if it does not for a long time."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def wait_for_replicas(vehicle: VehicleClient, count: int) -> None:
    """Return once so many replicas have announced themselves to a vehicle, each over its link."""
    liveliness = vehicle._network.session.liveliness()  # noqa: SLF001
    wait_until(
        lambda: len({str(r.ok.key_expr) for r in liveliness.get(LIVE_KEYS) if r.ok}) >= count
    )


def shortest(call: Callable[[], object]) -> float:
    """Measure the shortest of some calls in s, because a stall of the machine prolongs one."""
    times = []
    for _ in range(ATTEMPTS):
        begun = time.monotonic()
        call()
        times.append(time.monotonic() - begun)
    return min(times)
