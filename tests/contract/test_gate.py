"""The gate in Python has no limits of its own: a vehicle's are stated, all of them."""

from __future__ import annotations

import math
import re
from pathlib import Path

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

WIRE = Path(__file__).parents[2] / "docs/wire.md"
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


@pytest.mark.parametrize("seed", range(20))
def test_the_formulas_of_the_wire_document_give_the_commands_of_the_gate(seed: int) -> None:
    """The vehicle's angle follows the rates, but for jumps; limits, speeds and plans are random."""
    random = np.random.default_rng(seed)
    factors = {name: float(random.uniform(0.2, 1.0)) for name in LIMITS}
    limits = {name: value * factors[name] for name, value in LIMITS.items()}
    limits["mass"] = LIMITS["mass"]
    for name in ("steering_angle", "steering_slew"):
        limits[name] *= 10.0 ** -random.uniform(0.0, 2.0)
    stop, dt = -0.5 * limits["force_min"] / limits["mass"], float(random.choice([0.005, 0.02, 0.1]))
    blocks = re.findall(r"^```\n(.*?)^```$", WIRE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    (formulas,) = (block for block in blocks if "def towards" in block)
    known = {"clip": lambda a, b, c: min(max(a, b), c), "dt": dt, "stop_deceleration": stop}
    exec(formulas, f := {**vars(math), **limits, **known})  # noqa: S102
    gate = Gate(dt, limits | {"stop_deceleration": stop, "max_tail_ticks": 5.0})
    previous, delta = (0.0, 0.0), 0.0
    for tick in range(400):
        v_x = float(random.choice([0.0, *random.uniform(-1.0, 1.0, 2), *random.uniform(0, 60, 3)]))
        if random.uniform() < 0.1:
            delta = limits["steering_angle"] * float(random.uniform(-3.0, 9.0))
        wanted = (f["stop_force"](v_x), 0.0)
        if tick >= 20:
            planned = random.uniform(-1.5, 1.5, 2) * (limits["force_max"], limits["steering_rate"])
            wanted = (float(planned[0]), float(planned[1]) if tick % 100 < 50 else -9.0)
            gate.accept(tick, [wanted])
        command = gate.command(tick, v_x, delta)
        assert command.mode == ("waiting" if tick < 20 else "normal")
        expected = (
            f["limited_force"](wanted[0], previous[0], v_x),
            f["limited_rate"](wanted[1], previous[1], delta),
        )
        assert command.u == pytest.approx(expected, rel=1e-12, abs=1e-12)
        previous = command.u
        delta += dt * command.u[1]
