"""The baselines' libraries hold vehicles without GPs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from egp_service import EgpError
from egp_service._core import Library, Plant, VehicleParameters, slip_speed
from egp_service.evaluation import baselines
from egp_service.shipped import EVALUATION_LIBRARY
from egp_service.training.euler import euler_steps
from egp_service.training.prior_mean import PriorMean

if TYPE_CHECKING:
    from pathlib import Path

CONSTANT_MEAN = 5
Z = np.array([[15.0, 0.3, 0.4, 0.05, 2000.0, 0.1], [9.0, 1.0, -0.8, 0.2, -6000.0, -0.3]])


def baseline(path: Path, kind: str, vehicle: int = 1) -> Library:
    baselines.write(path / "baseline.safetensors", kind, EVALUATION_LIBRARY, [0, 3], vehicle)
    return Library.load(path / "baseline.safetensors")


def test_fitted_vehicles_keep_all_but_the_gps(tmp_path: Path) -> None:
    source = Library.load(EVALUATION_LIBRARY)
    library = baseline(tmp_path, "fitted")
    assert (library.dt, library.vehicle) == (source.dt, source.vehicle)
    for index, origin in enumerate([source.members[0], source.members[3]]):
        member = library.members[index]
        assert (member.label, member.friction) == (origin.label, origin.friction)
        assert member.n_points == 0
        assert origin.single_track is not None
        np.testing.assert_array_equal(member.single_track, origin.single_track)
        np.testing.assert_array_equal(member.noise_std, origin.noise_std)
        np.testing.assert_array_equal(member.envelope, origin.envelope)
        mean, _, variance = library.predict(Z, index)
        expected = PriorMean(origin.single_track, 1).predict(Z, library.dt)
        np.testing.assert_allclose(mean, expected, atol=1e-13)
        assert not variance.any()


def test_a_model_car_has_the_same_slip_in_both_languages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(baselines._CHASSIS, 1, (3.74, 0.159, 0.171, 0.047, 0.05))  # noqa: SLF001
    library = baseline(tmp_path, "single-track")
    (member,) = library.members
    assert member.single_track is not None
    # Below and above its slip speed of 1.2 m/s, and below that of a large car.
    z = np.array([[v_x, 0.2, 0.5, 0.1, 5.0, 0.4] for v_x in (0.8, 1.5, 2.5, 4.0)])
    assert slip_speed(0.33) == pytest.approx(1.22, abs=0.01)
    steps = euler_steps(member.single_track, library.dt)
    expected = PriorMean(member.single_track, steps).predict(z, library.dt)
    np.testing.assert_allclose(library.predict(z)[0], expected, atol=1e-12)


@pytest.mark.parametrize("vehicle", [1, 2])
def test_nominal_vehicles_are_those_of_commonroad(tmp_path: Path, vehicle: int) -> None:
    library = baseline(tmp_path, "kinematic", vehicle)
    assert library.parameters == VehicleParameters.commonroad(vehicle)
    (member,) = library.members
    np.testing.assert_array_equal(member.kinematic, baselines.kinematic(vehicle))
    outer = Library.load(EVALUATION_LIBRARY).members
    np.testing.assert_array_equal(
        member.envelope[1], np.maximum(outer[0].envelope[1], outer[3].envelope[1])
    )


def test_the_kinematic_vehicle_rolls_along_its_wheels(tmp_path: Path) -> None:
    library = baseline(tmp_path, "kinematic")
    mass, front, rear = baselines.kinematic(1)
    z = torch.tensor(Z, requires_grad=True)
    v_x, _, _, delta, force, delta_dot = z.unbind(-1)
    v_after = v_x + library.dt * force / mass
    turning = v_after * torch.tan(delta + library.dt * delta_dot) / (front + rear)
    after = torch.stack([v_after, rear * turning, turning], dim=-1) - z[:, :3]
    mean, jacobian, _ = library.predict(Z)
    np.testing.assert_allclose(mean, after.detach().numpy(), atol=1e-13)
    for output in range(3):
        (gradient,) = torch.autograd.grad(after[:, output].sum(), z, retain_graph=True)
        np.testing.assert_allclose(jacobian[:, output], gradient.numpy(), atol=1e-13)


@pytest.mark.parametrize("vehicle", [1, 2])
def test_the_single_track_drives_like_the_car_far_from_the_limit(
    tmp_path: Path, vehicle: int
) -> None:
    library = baseline(tmp_path, "single-track", vehicle)
    plant = Plant(vehicle)
    plant.reset(0.0, 0.0, 0.0, 12.0)
    motion = plant.vehicle_state[[2, 4, 5]]
    for k in range(150):
        u = np.array([0.0, 0.03 if k < 50 else 0.0])  # one second of slow steering, then hold
        z = np.concatenate([motion, plant.vehicle_state[[6]], u])[None]
        motion += library.predict(z)[0][0]
        plant.step(u, library.dt, 1.0)
    v_x, _, omega = plant.vehicle_state[[2, 4, 5]]
    assert motion[2] == pytest.approx(omega, rel=0.1)
    assert motion[0] == pytest.approx(v_x, rel=0.02)


def test_a_member_without_vehicle_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "none.safetensors"
    with pytest.raises(EgpError, match="has no vehicle: train with mean = 'single-track'"):
        baselines.write(path, "fitted", EVALUATION_LIBRARY, [CONSTANT_MEAN], 1)
    assert not path.exists()
