"""Objects of the extension that other processes may get, and what they look like."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Hashable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from egp_service import Controller, Path, Plant, Recorder, VehicleParameters, shipped
from egp_service._core import Friction
from egp_service.control.recorded import RecordedStep

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path as FilePath
    from typing import TypeVar

    from egp_service import Step

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
    *_, likelihood = told = step.friction.__getnewargs__()
    changes: list[dict[str, Any]] = [
        {"u": step.u + 1.0},
        {"u": step.u[:1]},
        {"plan_x": None},
        {"status": "late"},
        {"envelope_distance": 1.0},
        {"late": (b"reply",)},
        {"friction": None},
        {"friction": Friction(*told[:-1], likelihood - 1.0)},
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


def test_what_is_printed_shows_the_values(step: Step) -> None:
    friction = step.friction
    assert friction is not None
    assert repr(friction).startswith(f"Friction(mean={friction.mean:.3f}, std={friction.std:.3f}, ")
    assert repr(friction).endswith(f"informed={friction.informed})")
    assert repr(Path.rounded_rectangle()) == "Path(length=332.182, closed=True)"
