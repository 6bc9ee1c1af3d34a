"""The baselines' optimal control problem is the service's."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

from egp_service._core import (
    AffineOcp,
    EgpError,
    Engine,
    Library,
    Plant,
    VehicleParameters,
    horizon_reference,
    write_library_subset,
)
from egp_service.control.controller import Controller
from egp_service.evaluation.predictive_control import PredictiveController
from egp_service.evaluation.single_track import CHASSIS, Kinematic, SingleTrack, linearise
from egp_service.simulation.course import build_path, build_profile
from egp_service.simulation.scenario import Zone, library_path, load_scenario

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


CAR = VehicleParameters.commonroad(1)


def test_with_a_member_as_prediction_it_plans_what_the_service_plans(tmp_path: Path) -> None:
    scenario = load_scenario("rounded-rectangle")
    path = tmp_path / "one.safetensors"
    write_library_subset(library_path(scenario), path, [1])
    library = Library.load(path)
    engine = Engine(str(path))

    def member(z: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        mean, jacobian, _ = library.predict(z)
        return mean, jacobian

    ours = Controller(path, gate=CAR.gate_limits())
    same = PredictiveController(
        member,
        tomllib.loads(engine.settings_toml),
        engine.dt,
        vehicle=CAR,
        mass=CHASSIS[1].mass,
        friction=library.members[0].friction,
        gate=CAR.gate_limits(),
    )
    course = build_path(replace(scenario, zones=(Zone(0.0, 1.1),)))
    profile = build_profile(scenario, course)
    plant, s = Plant(1), 0.0
    plant.reset(0.0, -0.5, 0.05, 14.0)
    for _ in range(16):
        x = plant.vehicle_state
        reference, widths, projection = horizon_reference(
            course, profile, x, engine.dt, engine.horizon, s
        )
        s = projection.s
        expected, got = ours.step(x, reference, widths), same.step(x, reference, widths)
        assert expected.plan_u is not None
        assert got.plan_u is not None
        scale = np.array([CHASSIS[1].mass, 1.0])
        # Equal at first; each follows its own plans, so rounding grows from period to period.
        assert np.max(np.abs(got.plan_u - expected.plan_u) / scale) < 1e-6
        plant.step(expected.u, engine.dt, 1.1)


@pytest.mark.parametrize("vehicle", [1, 2])
def test_the_dynamic_single_track_drives_like_the_car_far_from_the_limit(vehicle: int) -> None:
    plant, dt = Plant(vehicle), 0.02
    plant.reset(0.0, 0.0, 0.0, 12.0)
    single_track = SingleTrack(CHASSIS[vehicle], friction=1.0)
    motion = plant.vehicle_state[[2, 4, 5]]
    for k in range(150):
        u = np.array([0.0, 0.03 if k < 50 else 0.0])  # one second of slow steering, then hold
        z = np.concatenate([motion, plant.vehicle_state[[6]], u])[None]
        motion += single_track(z, dt)[0]
        plant.step(u, dt, 1.0)
    v_x, _, omega = plant.vehicle_state[[2, 4, 5]]
    assert motion[2] == pytest.approx(omega, rel=0.1)
    assert motion[0] == pytest.approx(v_x, rel=0.02)


@pytest.mark.parametrize("prediction", [Kinematic(CHASSIS[1]), SingleTrack(CHASSIS[1])])
def test_their_jacobians_predict_small_changes(prediction: Kinematic | SingleTrack) -> None:
    rng = np.random.default_rng(1)
    scale = np.array([1e-3, 1e-3, 1e-4, 1e-4, 5.0, 1e-3])
    z = np.array([[12.0, 0.2, 0.3, 0.05, 800.0, 0.1]])
    value, jacobian = partial(linearise, prediction, dt=0.02)(z)
    for _ in range(5):
        step = rng.standard_normal(6) * scale
        change = prediction(z + step, 0.02) - value
        assert np.allclose(change[0], jacobian[0] @ step, atol=1e-6)


@pytest.mark.parametrize(
    ("dt", "friction", "message"),
    [(0.0, 0.8, "dt > 0 s, got 0"), (0.02, np.nan, "friction coefficient > 0, got NaN")],
)
def test_bad_periods_and_frictions_are_refused(dt: float, friction: float, message: str) -> None:
    with pytest.raises(EgpError, match=message):
        AffineOcp("", CAR, dt, friction)
