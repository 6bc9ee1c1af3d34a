"""Objects of the extension that other processes may get, and what they look like."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Hashable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from egp_service import (
    Controller,
    InvalidArgumentError,
    Library,
    LibraryError,
    Path,
    Plant,
    Recorder,
    RoadBelief,
    SpeedPlanner,
    SpeedProfile,
    VehicleParameters,
    horizon_reference,
    shipped,
)
from egp_service._core import Engine, Friction
from egp_service.control.recorded import RecordedStep
from egp_service.optimal_control import OcpBounds, OcpWeights, solve_ocp

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path as FilePath
    from typing import TypeVar

    from egp_service import Step
    from egp_service._core import Projection

    Copied = TypeVar("Copied")


def pickled(value: Copied) -> Copied:
    return pickle.loads(pickle.dumps(value))  # type: ignore[no-any-return]  # noqa: S301


COPIES = pytest.mark.parametrize("again", [pickled, copy.deepcopy, copy.copy])


@pytest.fixture(scope="module")
def step() -> Step:
    car = Plant().parameters
    with Controller(shipped.DEMO_LIBRARY, gate=car.gate_limits()) as controller:
        s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
        reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
        return controller.step([0.0, 0.2, 15.0, 0.0, 0.0, 0.0, 0.0], reference, deadline=5.0)


@COPIES
def test_a_vehicle_is_copied(again: Callable[[VehicleParameters], VehicleParameters]) -> None:
    car = VehicleParameters.commonroad(2)
    assert again(car) == car


@COPIES
def test_a_step_is_copied_with_its_friction(again: Callable[[Step], Step], step: Step) -> None:
    found = again(step)
    np.testing.assert_array_equal(found.u, step.u)
    assert found.reply == step.reply
    assert step.friction is not None
    assert found.friction is not None
    for name in ("mean", "std", "lower", "upper", "information", "informed"):
        assert getattr(found.friction, name) == getattr(step.friction, name)
    np.testing.assert_array_equal(found.friction.log_likelihood, step.friction.log_likelihood)


@COPIES
def test_a_copy_is_equal(again: Callable[[Step], Step], step: Step) -> None:
    assert again(step) == step
    recorded = RecordedStep(0.0, np.array([1.0, np.nan]), b"request", None)
    assert copy.deepcopy(recorded) == recorded
    assert not isinstance(step, Hashable)
    assert not isinstance(recorded, Hashable)


def test_another_value_makes_a_step_another_one(step: Step) -> None:
    assert step.friction is not None
    told = step.friction.__getnewargs__()
    changes: list[dict[str, Any]] = [
        {"u": step.u + 1.0},
        {"u": step.u[:1]},
        {"plan_x": None},
        {"status": "late"},
        {"envelope_distance": 1.0},
        {"late": (b"reply",)},
        {"friction": None},
        {"friction": Friction(*told[:6], told[6] - 1.0, told[7])},
    ]
    for change in changes:
        assert replace(step, **change) != step
    assert step != "step"


def test_what_is_printed_of_a_controller_and_a_recorder(tmp_path: FilePath, step: Step) -> None:
    limits = Plant().parameters.gate_limits()
    with Controller(shipped.DEMO_LIBRARY, gate=limits) as controller:
        told = f"{', '.join(controller.members)}: dt 0.02 s, horizon {controller.horizon}"
        assert repr(controller) == f"<Controller of {told}>"
        file = tmp_path / "run.mcap"
        with Recorder(file, controller) as recorder:
            recorder.add(step, np.zeros(7), 0.0)
            assert repr(recorder) == f"<Recorder of {file}: 1 step>"
        assert repr(recorder) == f"<Recorder of {file}: 1 step, closed>"
    assert repr(controller) == f"<Controller of {told}, closed>"


@COPIES
def test_a_path_is_copied_with_the_same_bits(again: Callable[[Path], Path]) -> None:
    zones = [(0.0, "ice"), (0.3, 0.5, "snow"), (0.6, {"peak": 0.7, "lateral_shape": 1.02})]
    points = np.column_stack([np.arange(20.0), np.sin(np.arange(20.0) / 3.0)])
    for path in (
        Path.rounded_rectangle(),
        Path.l_shape().with_friction(zones),
        Path.from_points(points, closed=False),
    ):
        found = again(path)
        s = np.linspace(-9.0, 2.0 * path.length, 333)
        np.testing.assert_array_equal(found.sample(s), path.sample(s))
        x = np.array([3.0, 1.0, 10.0, 0.0, 0.0, 0.0, 0.0])
        assert vars_of(found.project(x[:2])) == vars_of(path.project(x[:2]))
        profile = SpeedProfile.constant(path, 10.0)
        rows, *_ = horizon_reference(found, profile, x, 0.05, 9)
        np.testing.assert_array_equal(rows, horizon_reference(path, profile, x, 0.05, 9)[0])


def vars_of(projection: Projection) -> list[float]:
    return [getattr(projection, name) for name in dir(projection) if not name.startswith("_")]


@pytest.mark.parametrize("zones", ["split", "shifted"])
def test_a_copied_path_has_the_same_surfaces(zones: str) -> None:
    surfaces: dict[str, list[Any]] = {
        "split": [(0.0, "ice", "snow")],
        "shifted": [(0.0, {"peak": 0.7, "shift": 0.4, "curvature": 0.9, "lateral_stiffness": 0.8})],
    }
    path = Path.rounded_rectangle().with_friction(surfaces[zones])
    driven = []
    for road in (path, pickled(path)):
        plant = Plant()
        plant.reset(0.0, 0.0, 0.0, 12.0, delta=0.02)
        plant.step([-2000.0, 0.1], 0.3, road)
        driven.append(plant.state)
    np.testing.assert_array_equal(driven[0], driven[1])


@COPIES
def test_a_library_and_its_members_are_copied(again: Callable[[Any], Any]) -> None:
    library = Library.load(shipped.DEMO_LIBRARY)
    z = np.array([[15.0, 0.1, 0.2, 0.03, 500.0, 0.0]])
    found, (first, second) = again((library, library.members))
    assert (found.id, found.provenance) == (library.id, library.provenance)
    assert [first.label, second.label] == [member.label for member in library.members]
    for number in range(2):
        for a, b in zip(found.predict(z, number), library.predict(z, number), strict=True):
            np.testing.assert_array_equal(a, b)


def test_pickled_numbers_and_bytes_that_are_damaged_are_an_error() -> None:
    reduced: Any = Path.rounded_rectangle().__reduce__()
    restore, (closed, step, pieces, widths, zones) = reduced
    for damaged in (
        (closed, 0.0, pieces, widths, zones),
        (closed, step, pieces[:0], None, zones),
        (closed, step, pieces[:, :, :3], widths, zones),
        (closed, step, np.nan * pieces, widths, zones),
        (closed, step, pieces, widths[1:], zones),
        (not closed, step, pieces, widths, zones),
        (closed, step, pieces, widths, [(0.5, [1.0] * 9, None)]),
        (closed, step, pieces, widths, [(0.0, [-1.0] * 9, None)]),
    ):
        with pytest.raises(InvalidArgumentError):
            restore(*damaged)
    reduced = Library.load(shipped.DEMO_LIBRARY).__reduce__()
    restore, (content,) = reduced
    with pytest.raises(LibraryError):
        restore(content[:-8])


def test_what_has_no_copy_says_so() -> None:
    with pytest.raises(TypeError, match="cannot pickle"):
        pickle.dumps(Plant())


def test_each_object_is_printed_in_a_line() -> None:
    path = Path.rounded_rectangle()
    car = Plant().parameters
    library = Library.load(shipped.DEMO_LIBRARY)
    plant = Plant(2)
    plant.reset(1.0, 2.0, 0.5, 10.0)
    bound = [0.0, 0.0]
    made_of = f"vehicle='commonroad-1', id='{library.id[:12]}...'"
    constant = "slowest=10.000, fastest=10.000"
    for shown, expected in (
        (plant, "Plant(vehicle=2, x=1.000, y=2.000, yaw=0.5000, v=10.000)"),
        (
            RoadBelief(path),
            "RoadBelief(length=332.182, closed=True, window=25, tiles=3)",
        ),
        (
            library,
            f"Library(members=['mu 0.5', 'mu 1.1'], dt=0.02, kernel='matern52', {made_of})",
        ),
        (library.members[0], "Member(label='mu 0.5', friction=0.5, n_points=400)"),
        (
            SpeedProfile.constant(path, 10.0),
            f"SpeedProfile(start=0.000, length=332.182, lap_time=33.218, {constant})",
        ),
        (
            SpeedPlanner(path, car),
            "SpeedPlanner(closed=True, places=252, step=0.998, grip=0.8, v_max=30.0)",
        ),
        (
            OcpWeights(q=np.eye(7), r=[1.0, 2.0], r_d=bound),
            "OcpWeights(q of shape (7, 7), r=[1.0, 2.0], r_d=[0.0, 0.0])",
        ),
        (
            OcpBounds(u_min=bound, u_max=bound, du_min=bound, du_max=np.zeros((5, 2))),
            "OcpBounds(u_min of shape (2,), u_max (2,), du_min (2,), du_max (5, 2), soft rows: 0)",
        ),
        (
            solve_ocp(
                np.eye(7)[None],
                np.zeros((7, 2)),
                np.zeros(7),
                np.zeros(7),
                bound,
                np.eye(7)[0],
                OcpWeights(q=np.eye(7), r=[1.0, 1.0], r_d=bound),
                OcpBounds(u_min=bound, u_max=bound, du_min=bound, du_max=bound),
            ).multipliers,
            "OcpMultipliers(stages=1)",
        ),
        (
            Engine(shipped.DEMO_LIBRARY),
            "Engine(members=['mu 0.5', 'mu 1.1'], dt=0.02, horizon=40, history=25)",
        ),
    ):
        assert repr(shown) == expected


def test_what_is_printed_shows_the_values(step: Step) -> None:
    friction = step.friction
    assert friction is not None
    assert repr(friction).startswith(f"Friction(mean={friction.mean:.3f}, std={friction.std:.3f}, ")
    assert repr(friction).endswith(f"informed={friction.informed}, misfit={friction.misfit:.3f})")
    assert repr(Path.rounded_rectangle()) == "Path(length=332.182, closed=True)"
