"""Objects of the extension that other processes may get, and what they look like."""

from __future__ import annotations

import copy
import pickle
from typing import TYPE_CHECKING

import numpy as np
import pytest

from egp_service import Controller, Path, Plant, VehicleParameters, shipped

if TYPE_CHECKING:
    from collections.abc import Callable
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


def test_what_is_printed_shows_the_values(step: Step) -> None:
    friction = step.friction
    assert friction is not None
    assert repr(friction).startswith(f"Friction(mean={friction.mean:.3f}, std={friction.std:.3f}, ")
    assert repr(friction).endswith(f"informed={friction.informed})")
    assert repr(Path.rounded_rectangle()) == "Path(length=332.182, closed=True)"
