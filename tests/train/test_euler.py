"""The number of Euler steps of a fitted vehicle."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from surfaces import provenance

from egp_service import Library, shipped
from egp_service.data.dataset import Dataset
from egp_service.training.euler import euler_steps
from egp_service.training.prior_mean import PriorMean
from egp_service.training.vehicle_fit import fit_vehicle

CAR = np.array(Library.load(shipped.DEMO_LIBRARY).members[1].single_track)
# Wide tyres under a light car that turns easily, as in racing.
RACING = CAR.copy()
RACING[[0, 3]] = 790.0, 1.0
RACING[[10, 15]] *= 2.0


def after_a_second(vehicle: np.ndarray, dt: float, steps: int) -> float:
    """Lateral motion that is left of 0.01 m/s and 0.01 rad/s at 3 m/s, in m/s or rad/s."""
    z = np.array([[3.0, 0.01, 0.01, 0.0, 0.0, 0.0]])
    for _ in range(round(1.0 / dt)):
        z[:, 1:3] += PriorMean(vehicle, steps).predict(z, dt)[:, 1:]
    return float(np.abs(z[:, 1:3]).max())


@pytest.mark.parametrize("dt", [0.01, 0.02, 0.025, 1.0 / 30.0, 0.04, 0.05, 0.1])
@pytest.mark.parametrize("vehicle", [CAR, RACING], ids=["road", "racing"])
def test_a_slow_vehicle_comes_to_rest(vehicle: np.ndarray, dt: float) -> None:
    steps = euler_steps(vehicle, dt)
    assert after_a_second(vehicle, dt, steps) < 1e-4
    if steps > 1:
        assert after_a_second(vehicle, dt, 1) > 0.01


def test_the_simulated_car_needs_one_step_at_20_ms() -> None:
    assert [euler_steps(CAR, dt) for dt in (0.02, 0.021, 0.023, 0.043)] == [1, 1, 2, 2]


def test_the_steps_of_a_vehicle_that_is_none_are_bounded() -> None:
    noise = CAR.copy()
    noise[[3, 10, 15]] = 0.2, 100.0, 100.0
    # A library states at most 100, and each one costs time.
    assert [euler_steps(noise, dt) for dt in (0.04, 1.0)] == [12, 100]


# At 50 ms the vehicle needs 6.05 steps, and rounding decides between six and seven.
@pytest.mark.parametrize("dt", [0.02, 0.052])
def test_a_vehicle_is_fitted_with_the_steps_that_it_needs(dt: float) -> None:
    rng = np.random.default_rng(0)
    spread = np.array([8.0, 0.6, 0.5, 0.1, 6000.0, 0.3])
    z = np.array([15.0, *np.zeros(5)]) + spread * rng.uniform(-1.0, 1.0, (1500, 6))
    steps = euler_steps(RACING, dt)
    data = Dataset(
        z=z,
        y=PriorMean(RACING, steps).predict(z, dt),
        trajectory=np.arange(1500, dtype=np.uint32),
        step=np.zeros(1500, dtype=np.uint32),
        provenance=dataclasses.replace(provenance(vehicle="commonroad-2"), dt=dt),
    )
    (found,) = fit_vehicle([data], None, [rng])
    assert found.steps == steps > 1
    grip_and_stiffness = [9, 10, 14, 15]
    np.testing.assert_allclose(
        found.values[grip_and_stiffness], RACING[grip_and_stiffness], rtol=0.02
    )
