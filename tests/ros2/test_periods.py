# mypy: disable-error-code="arg-type"
"""When the periods of a vehicle behind topics begin, and the state that they use."""

# ruff: noqa: E402 - the libraries of the extra may be missing
from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

for name in ("rosbags", "ruamel.yaml", "xxhash", "pycdr2"):
    pytest.importorskip(name, reason=f"{name} comes with `make setup`")

from egp_service import Plant
from egp_service.quantities import DELTA, P_X, P_Y, PSI
from egp_service.ros2 import messages
from egp_service.ros2.driving import Drive, Vehicle
from ros2 import idl, vehicle
from ros2.topics import Topics

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from ros2.topics import Clock

DT, SPEED, RADIUS, SECONDS = 0.02, 10.0, 40.0, 4.0
SETTINGS: dict[str, Any] = {"odometry": "odom", "path": "plan", "control": None}
RATE = 0.01
"""Steering rate that the controller commands, rad/s."""


def on_the_circle(time: float) -> NDArray[np.float64]:
    """Give the state of a vehicle that drives on a circle at a constant speed."""
    turned = time * SPEED / RADIUS
    x, y = RADIUS * np.sin(turned), RADIUS - RADIUS * np.cos(turned)
    return np.array([x, y, SPEED, turned, 0.0, SPEED / RADIUS, 0.0])


def circle() -> object:
    header = idl.Header(idl.Time(), "map")
    states = map(on_the_circle, np.linspace(0.0, 2.0 * np.pi * RADIUS / SPEED, 252)[:-1])
    poses = [idl.PoseStamped(header, vehicle.pose(x[P_X], x[P_Y], x[PSI])) for x in states]
    return messages.decode(idl.Path(header, poses).serialize(), messages.PATH)


class Controller:
    """Keeps times and states, takes a part of the period, and commands a steering rate."""

    dt, horizon = DT, 40

    def __init__(self, clock: Clock, cost: float) -> None:
        self.periods: list[tuple[float, NDArray[np.float64]]] = []
        self._clock, self._cost = clock, cost

    def step(self, x: NDArray[np.float64], *_: object, deadline: float | None = None) -> object:
        """Let the time of a step pass."""
        del deadline
        self.periods.append((self._clock.now, x.copy()))
        self._clock.sleep(self._cost)
        return SimpleNamespace(u=np.array([0.0, RATE]), mode="normal")


def driven(
    clock: Clock, arrivals: Iterable[float], cost: float = 0.006
) -> tuple[list[tuple[float, NDArray[np.float64]]], Topics]:
    """Drive on the circle with odometry that is measured and arrives at these times."""
    begun, timetable = clock.now, []
    for number, after in enumerate(arrivals, 1):
        message: Any = messages.decode(
            vehicle.odometry(on_the_circle(after), 0.0), messages.ODOMETRY
        )
        message.header.stamp.sec, message.header.stamp.nanosec = number, 0
        timetable.append((begun + after, "odom", message))
    topics, controller = Topics(clock, timetable), Controller(clock, cost)
    topics.messages["plan"] = circle()
    settings = Drive(Plant().parameters, 0.0, friction=1.0, v_max=20.0, **SETTINGS)
    Vehicle(topics, controller, settings).run(lambda _: None, SECONDS)
    return [(time - begun, x) for time, x in controller.periods], topics


@pytest.mark.parametrize("rate", [10, 20, 30, 45, 50, 51, 60, 67, 90, 100, 200])
def test_periods_are_those_of_the_model_whatever_the_rate_of_the_odometry_is(
    clock: Clock, rate: float
) -> None:
    periods, topics = driven(clock, np.arange(0.0, SECONDS, 1.0 / rate))
    expected = SECONDS / DT * (51 / 50 if rate == 51 else 1.0)
    assert len(periods) == pytest.approx(expected, abs=4)
    lengths = np.diff([time for time, _ in periods])
    assert lengths.min() > 0.69 * DT
    assert lengths.max() < 1.21 * DT
    # Wheels that turn at the commanded rate have the commanded angle.
    (end, _), angle = periods[-1], topics.commands[-1].drive.steering_angle
    assert angle == pytest.approx(RATE * (end + DT), rel=0.03 if rate == 51 else 0.015)


@pytest.mark.parametrize("rate", [10, 20, 30, 50, 67, 100, 200])
def test_the_state_is_that_of_the_time_at_which_the_period_begins(
    clock: Clock, rate: float
) -> None:
    periods, _ = driven(clock, np.arange(0.0, SECONDS, 1.0 / rate))
    for time, x in periods:
        np.testing.assert_allclose(x[:DELTA], on_the_circle(time)[:DELTA], rtol=0.0, atol=1e-9)


def test_a_period_begins_with_odometry_that_comes_once_in_each(clock: Clock) -> None:
    random = np.random.default_rng(1)
    regular = np.arange(0.0, SECONDS + 2.0 * DT, DT)
    arrivals = regular + random.uniform(0.0, 0.1 * DT, len(regular))
    lost = len(arrivals) // 2
    arrivals = np.delete(arrivals, lost)
    periods, _ = driven(clock, arrivals)
    ages = [float(np.min((time - arrivals)[arrivals <= time + 1e-9])) for time, _ in periods]
    # That it comes so is known after nine messages without a loss.
    for steady in (ages[12 : lost - 2], ages[lost + 12 :]):
        assert max(steady) < 1e-9


def test_a_step_that_takes_too_long_is_not_made_up_for_by_short_periods(clock: Clock) -> None:
    periods, _ = driven(clock, np.arange(0.0, SECONDS, 0.01), cost=1.6 * DT)
    lengths = [end - begin for (begin, _), (end, _) in pairwise(periods)]
    assert min(lengths) == pytest.approx(1.6 * DT)
    assert max(lengths) == pytest.approx(1.6 * DT)
