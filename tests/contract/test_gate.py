"""The gate in Python has no limits of its own: a vehicle's are stated, all of them."""

from __future__ import annotations

import numpy as np
import pytest

from egp_service._core import (
    EgpError,
    Engine,
    InProcessDriver,
    InvalidArgumentError,
    VehicleParameters,
)
from egp_service._core.testing import Gate
from egp_service.shipped import DEMO_LIBRARY

LIMITS = VehicleParameters.commonroad(1).gate_limits()


@pytest.mark.parametrize("name", LIMITS)
def test_every_limit_must_be_stated(name: str) -> None:
    stated = {other: value for other, value in LIMITS.items() if other != name}
    with pytest.raises(EgpError, match=f"gate limit {name} is missing"):
        Gate(0.02, stated)


def test_unknown_and_impossible_settings_are_refused() -> None:
    for change, named in (
        ({"tail": 3.0}, "tail"),
        ({"max_tail_ticks": 1.5}, "max_tail_ticks"),
        ({"force_max": -1.0}, "force_max"),
        (
            {"stop_deceleration": 9.0},
            r"stop_deceleration is 9 m/s², .*-force_min / mass = 8.* m/s²",
        ),
    ):
        with pytest.raises(EgpError, match=named):
            Gate(0.02, LIMITS | change)


@pytest.mark.parametrize("name", ["force_max", "steering_rate"])
def test_the_stated_limits_hold(name: str) -> None:
    at = {"force_max": 0, "steering_rate": 1}[name]
    gate = Gate(0.02, LIMITS | {name: 0.1, "force_slew": 1e9, "steering_slew": 1e9})
    gate.accept(0, [(5000.0, 0.3)])
    command = gate.command(0, 10.0, 0.0)
    assert command.u[at] == 0.1
    assert command.u[1 - at] == (5000.0, 0.3)[1 - at]
    assert command.limited


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steering_rate": 0.6}, r"steering_rate is 0\.6 rad/s, .* has 0\.4 rad/s"),
        ({"mass": 1100.0}, r"mass is 1100 kg, .* has 1225\.887 kg"),
    ],
)
def test_a_driver_accepts_no_gate_wider_than_the_librarys_vehicle(
    change: dict[str, float], message: str
) -> None:
    engine = Engine(str(DEMO_LIBRARY))
    with pytest.raises(InvalidArgumentError, match=message):
        InProcessDriver(engine, gate=LIMITS | change)
    InProcessDriver(engine, gate=LIMITS | {"steering_rate": 0.3, "max_tail_ticks": 5.0})


def test_a_driver_accepts_limits_that_differ_by_rounding_and_the_same_car_with_another_load() -> (
    None
):
    engine = Engine(DEMO_LIBRARY)
    single = {name: float(np.float32(value)) for name, value in LIMITS.items()}
    assert single["steering_angle"] > LIMITS["steering_angle"]
    InProcessDriver(engine, gate=single)
    for mass in (1226.0, 1.0099 * LIMITS["mass"], 0.9901 * LIMITS["mass"]):
        fields = VehicleParameters.commonroad(1).fields() | {"mass": mass}
        InProcessDriver(engine, gate=VehicleParameters(**fields).gate_limits())
        InProcessDriver(engine, gate=LIMITS | {"mass": mass})
    for change, message in (
        ({"steering_angle": 0.9101}, r"steering_angle is 0\.9101 rad"),
        ({"force_max": 7356.0}, r"force_max is 7356 N, .* has 7355\.322 N; narrow"),
        (
            {"force_max": 7381.0, "mass": 1230.0},
            r"has 7355\.322 N at 1225\.887 kg, which is 7380 N at the gate's mass of 1230 kg; ",
        ),
        ({"force_max": 7356.0, "mass": 1220.0}, r"force_max is 7356 N, .* has 7355\.322 N; narrow"),
    ):
        with pytest.raises(InvalidArgumentError, match=message):
            InProcessDriver(engine, gate=LIMITS | change)
