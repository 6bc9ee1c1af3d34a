"""The plant against `commonroad-vehicle-models`, the package its equations come from."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from vehiclemodels.init_mb import init_mb
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

from egp_service import EgpError
from egp_service._core import Path, Plant, surface_friction
from egp_service._core.testing import (
    plant_derivative,
    plant_initial_states,
    plant_lateral_acceleration,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Vector = NDArray[np.float64]

VEHICLES = (1, 2)
GRAVITY = 9.81


@cache
def package_parameters(vehicle: int) -> Any:  # noqa: ANN401, the package is untyped
    return setup_vehicle_parameters(vehicle)


def oracle(vehicle: int, friction: float) -> Any:  # noqa: ANN401
    """Set the package's parameters, one object per vehicle, to a surface."""
    parameters = package_parameters(vehicle)
    parameters.tire.p_dx1 = friction
    parameters.tire.p_dy1 = 0.9 * friction
    return parameters


def oracle_slope(vehicle: int, friction: float, u: Vector) -> Callable[[float, Vector], Vector]:
    """`f(t, x)` of the package; it takes `[delta_dot, a]` and writes into the list it is given."""
    parameters = oracle(vehicle, friction)
    command = [float(u[1]), float(u[0]) / parameters.m]

    def slope(_: float, x: Vector) -> Vector:
        return np.array(vehicle_dynamics_mb(list(x), command, parameters))

    return slope


def random_state(rng: np.random.Generator, vehicle: int, speed: float) -> Vector:
    """Draw a state with everything disturbed, in one of seven a wheel below zero."""
    v_y, omega = rng.normal(size=2) * (0.05, 0.02) * abs(speed)
    seen = [*rng.normal(size=2) * 100, abs(speed), rng.uniform(-4, 4), v_y, omega, 0.0]
    x: Vector = plant_initial_states(np.array([seen]), vehicle)[0]
    x[2], x[3] = rng.uniform(-0.9, 0.9), speed
    x[6:10] += rng.normal(size=4) * 0.1
    axle = [0.1, 0.1, 0.1, 0.01, 0.1]
    x[11:23] += rng.normal(size=12) * np.array([0.02, 0.1, *axle, *axle])
    x[23:27] *= rng.uniform(0.7, 1.3, size=4)
    if rng.random() < 1 / 7:
        x[23 + rng.integers(4)] = -0.5
    x[27:] += rng.normal(size=2) * 0.05
    return x


@pytest.mark.parametrize("low_speed", [False, True])
@pytest.mark.parametrize("vehicle", VEHICLES)
def test_right_hand_side(vehicle: int, low_speed: bool) -> None:  # noqa: FBT001
    """1000 random states each, beyond the actuator limits and below 0.1 m/s, backward included."""
    rng = np.random.default_rng(vehicle)
    compared = 0
    while compared < 1000:
        speed = rng.uniform(-0.0999, 0.0999) if low_speed else rng.uniform(0.1, 45.0)
        friction = rng.uniform(0.1, 1.3)
        x = random_state(rng, vehicle, speed)
        u = np.array([rng.uniform(-18e3, 18e3), rng.uniform(-0.6, 0.6)])
        try:
            expected = oracle_slope(vehicle, friction, u)(0.0, x)
        except ZeroDivisionError:  # a wheel moves backward
            with pytest.raises(EgpError, match="spun"):
                plant_derivative(x, u, friction, vehicle)
            continue
        got = plant_derivative(x, u, friction, vehicle)
        # Relative to each component, or to 1 SI unit where large forces cancel to less than that.
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)
        compared += 1


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_initial_state_is_the_packages_but_for_the_bodys_height_and_pitch(vehicle: int) -> None:
    x, y, v_x, yaw, v_y, yaw_rate, delta = 3.0, -4.0, 12.0, 0.3, 0.5, 0.2, 0.05
    start = [x, y, delta, math.hypot(v_x, v_y), yaw, yaw_rate, math.atan2(v_y, v_x)]
    expected = np.array(init_mb(start, oracle(vehicle, 1.0)))
    plant = Plant(vehicle)
    plant.reset(x, y, yaw, v_x, yaw_rate=yaw_rate, v_y=v_y, delta=delta)
    same = np.setdiff1d(np.arange(29), [8, 11])
    np.testing.assert_allclose(plant.state[same], expected[same], rtol=1e-14, atol=1e-14)
    np.testing.assert_array_equal(plant.vehicle_state, [x, y, v_x, yaw, v_y, yaw_rate, delta])
    # Balanced: nothing accelerates vertically, which the package's own initial state does.
    slope = plant_derivative(plant.state, np.zeros(2), 1.0, vehicle)
    np.testing.assert_allclose(slope[[12, 17, 22]], 0.0, atol=1e-9)


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("friction", [0.5, 1.1])
def test_trajectory_of_the_same_integrator(vehicle: int, friction: float) -> None:
    """One second of RK4 with 2 ms, short enough that the plant takes it in one substep."""
    plant, h = Plant(vehicle), 2e-3
    plant.reset(0.0, 0.0, 0.1, 18.0, delta=0.01)
    x = plant.state
    for k in range(500):
        u = np.array([2000.0 * math.sin(0.02 * k), 0.2 * math.cos(0.01 * k)])
        slope = oracle_slope(vehicle, friction, u)
        k1 = slope(0.0, x)
        k2 = slope(0.0, x + h / 2 * k1)
        k3 = slope(0.0, x + h / 2 * k2)
        k4 = slope(0.0, x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        plant.step(u, h, friction)
    np.testing.assert_allclose(plant.state, x, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("speed", [3.0, 10.0, 20.0])
def test_trajectory_of_an_adaptive_integrator(vehicle: int, speed: float) -> None:
    """Half a second in one call, as the closed loop steps, within a millimetre of SciPy's."""
    plant = Plant(vehicle)
    plant.reset(0.0, 0.0, 0.1, speed, delta=0.02)
    u = np.array([-2.0 * plant.mass, 0.1])
    exact = solve_ivp(
        oracle_slope(vehicle, 0.8, u), (0.0, 0.5), plant.state, method="LSODA", rtol=1e-8, atol=1e-9
    )
    assert exact.success
    plant.step(u, 0.5, 0.8)
    error = plant.vehicle_state - exact.y[[0, 1, 3, 4, 10, 5, 2], -1]
    np.testing.assert_allclose(error, 0.0, atol=1e-3)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_actuator_limits(vehicle: int) -> None:
    limits = oracle(vehicle, 1.0)

    def state_after(force: float, steering_rate: float, seconds: float) -> Vector:
        plant = Plant(vehicle)
        plant.reset(0.0, 0.0, 0.0, 20.0)
        plant.step(np.array([force, steering_rate]), seconds, 0.9)
        return plant.state

    power = limits.longitudinal.a_max * limits.longitudinal.v_switch / 20.0 * limits.m
    force = limits.longitudinal.a_max * limits.m
    # So short that the limit of the force, which decreases with speed, stays that of the start.
    np.testing.assert_allclose(state_after(1e6, 9.0, 1e-4), state_after(power, 0.4, 1e-4))
    np.testing.assert_allclose(state_after(-1e6, -9.0, 1e-3), state_after(-force, -0.4, 1e-3))
    assert state_after(0.0, 9.0, 4.0)[2] == limits.steering.max


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("friction", [0.3, 0.6, 0.9])
def test_no_force_beyond_friction_and_no_energy_from_nothing(vehicle: int, friction: float) -> None:
    """Not above mu 0.9: there a wheel lifts, and the equations let a lifted wheel drive."""
    plant = Plant(vehicle)
    parameters = oracle(vehicle, friction)

    def kinetic_energy() -> float:
        x = plant.state
        planar = parameters.m * (x[3] ** 2 + x[10] ** 2) + parameters.I_z * x[5] ** 2
        return float(planar + parameters.I_y_w * np.sum(x[23:27] ** 2)) / 2

    plant.reset(0.0, 0.0, 0.0, 25.0)
    plant.step(np.array([-1e6, 0.0]), 1.0, friction)
    assert 25.0 - plant.vehicle_state[2] <= 1.02 * friction * GRAVITY

    plant.reset(0.0, 0.0, 0.0, 20.0)
    energy = kinetic_energy()
    for _ in range(60):
        plant.step(np.array([0.0, 0.1]), 0.05, friction)
        assert abs(plant_lateral_acceleration(plant)) <= 1.1 * friction * GRAVITY
        # The suspension returns some energy of roll and pitch; 20 J are 1 cm of heave.
        assert kinetic_energy() <= energy + 20.0
        energy = kinetic_energy()


def test_split_friction_enters_by_wheel() -> None:
    """Ice on the left: braking turns the vehicle to the right, on a path as wheel by wheel."""
    plant = Plant()
    plant.reset(0.0, 0.0, 0.0, 20.0)
    brake = np.array([-6.0 * plant.mass, 0.0])
    points = np.column_stack([np.linspace(-100.0, 100.0, 41), np.zeros(41)])
    split = Path.from_points(points, closed=False).with_friction([(0.0, 0.2, 1.0)])
    plant.step(brake, 0.2, split)
    assert plant.vehicle_state[5] < -0.05

    slip = plant.state
    slip[23:27] *= 0.9
    even = plant_derivative(slip, brake, 1.0)
    same = plant_derivative(slip, brake, np.ones(4))
    uneven = plant_derivative(slip, brake, np.array([1.0, 0.2, 1.0, 0.2]))
    np.testing.assert_array_equal(even, same)
    assert uneven[5] < even[5] - 1.0


def test_friction_of_a_path_is_that_of_its_zones() -> None:
    """Dry before the line, ice behind it: the front wheels get there first."""
    points = np.column_stack([np.linspace(-100.0, 100.0, 41), np.zeros(41)])
    line = Path.from_points(points, closed=False).with_friction([(0.0, 1.0), (0.5, 0.2)])
    brake = np.array([-6000.0, 0.0])

    def braked(start: float, friction: float | Path, hint: float | None = None) -> Vector:
        plant = Plant()
        plant.reset(start, 0.3, 0.0, 20.0)
        plant.step(brake, 0.05, friction, hint)
        return plant.state

    np.testing.assert_array_equal(braked(-50.0, line), braked(-50.0, 1.0))
    np.testing.assert_array_equal(braked(50.0, line), braked(50.0, 0.2))
    front_on_ice = braked(0.0, line)
    # The front wheels lock, the rear ones don't.
    assert np.all(front_on_ice[23:25] < 0.9 * front_on_ice[25:27])
    for hint in (0.0, 99.0, 200.0):
        np.testing.assert_array_equal(braked(0.0, line, hint), front_on_ice)


def test_braking_on_a_split_road_turns_to_the_side_that_grips() -> None:
    points = np.column_stack([np.linspace(-100.0, 100.0, 41), np.zeros(41)])
    line = Path.from_points(points, closed=False)
    brake = np.array([-6000.0, 0.0])

    def yaw_rate(left: float, right: float) -> float:
        plant = Plant()
        plant.reset(0.0, 0.0, 0.0, 20.0)
        plant.step(brake, 0.2, line.with_friction([(0.0, left, right)]))
        return float(plant.vehicle_state[5])

    assert yaw_rate(1.0, 0.2) > 0.05
    assert yaw_rate(0.2, 1.0) < -0.05
    assert abs(yaw_rate(0.6, 0.6)) < 0.005  # the tyres are not quite symmetric


def test_a_disturbance_of_zero_changes_no_bit() -> None:
    """Disturbances of zero give the same bits as none; any other value changes the state."""
    names = ["load", "wear_front", "wear_rear", "brake_bias", "brake_pull", "wind_y", "grade"]

    def driven(disturbances: dict[str, float] | None) -> Vector:
        plant = Plant(1, disturbances)
        plant.reset(0.0, 0.0, 0.1, 18.0, delta=0.01)
        plant.step(np.array([-3000.0, 0.1]), 0.2, 0.9)
        return plant.state

    undisturbed = driven(None)
    np.testing.assert_array_equal(
        driven(dict.fromkeys([*names, "bank", "load_x"], 0.0)), undisturbed
    )
    for name in [*names, "bank"]:
        assert np.any(driven({name: 0.1}) != undisturbed)


def test_a_surface_is_a_number_a_preset_or_a_table() -> None:
    def driven(surface: float | str | dict[str, float] | Path) -> Vector:
        plant = Plant()
        plant.reset(0.0, 0.0, 0.0, 15.0, delta=0.02)
        plant.step(np.array([-2000.0, 0.1]), 0.2, surface)
        return plant.state

    np.testing.assert_array_equal(driven("dry"), driven(1.0))
    np.testing.assert_array_equal(driven({"peak": 0.6}), driven(0.6))
    same = {"peak": 0.6, "lateral_peak": 0.9 * 0.6, "lateral_stiffness": 1.0}
    np.testing.assert_array_equal(driven(same), driven(0.6))
    assert np.any(driven("snow") != driven(0.3))
    assert surface_friction("snow") == 0.3
    points = np.column_stack([np.linspace(-100.0, 100.0, 41), np.zeros(41)])
    line = Path.from_points(points, closed=False).with_friction([(0.0, "snow")])
    np.testing.assert_array_equal(driven(line), driven("snow"))
    with pytest.raises(EgpError, match="no surface"):
        driven("mud")


def test_refusals_keep_the_state() -> None:
    plant = Plant()
    plant.reset(0.0, 0.0, 0.0, 10.0)
    before = plant.state
    coast = np.zeros(2)
    with pytest.raises(EgpError, match="finite F_x, got NaN"):
        plant.step(np.array([np.nan, 0.0]), 0.05, 1.0)
    with pytest.raises(EgpError, match=r"shape \(2,\), got \(3,\)"):
        plant.step(np.zeros(3), 0.05, 1.0)
    with pytest.raises(EgpError, match="dt > 0"):
        plant.step(coast, 0.0, 1.0)
    for friction in (-0.1, 0.0, 8.0, math.nan):
        with pytest.raises(EgpError, match="friction coefficient > 0"):
            plant.step(coast, 0.05, friction)
    with pytest.raises(EgpError, match="finite hint, got NaN"):
        plant.step(coast, 0.05, 1.0, math.nan)
    with pytest.raises(EgpError, match="only drives forward"):
        plant.reset(0.0, 0.0, 0.0, -1.0)
    with pytest.raises(EgpError, match=r"vehicles 1, 2.*, got 0"):
        Plant(0)
    np.testing.assert_array_equal(plant.state, before)
    plant.reset(0.0, 0.0, 0.0, 5.0, yaw_rate=20.0)
    before = plant.state
    with pytest.raises(EgpError, match="has spun"):
        plant.step(coast, 0.05, 1.0)
    np.testing.assert_array_equal(plant.state, before)
