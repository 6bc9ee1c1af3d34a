"""Arguments of another type: each error names the argument, what was expected, and what came."""

from __future__ import annotations

import copy
import pickle
from collections import UserDict
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import pytest

from egp_service import (
    Controller,
    FleetMap,
    InvalidArgumentError,
    Plant,
    Recorder,
    StatusPublisher,
    VehicleClient,
)
from egp_service.control.recorded import read_recording
from egp_service.shipped import DEMO_LIBRARY
from egp_service.simulation.environment import TrackEnvironment
from egp_service.simulation.scenario import load_scenario

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

GATE = Plant().parameters.gate_limits()
NOBODY = "tcp/127.0.0.1:9"
X = [0.0, 0.1, 15.0, 0.0, 0.0, 0.0, 0.0]
NOTHING: Any = None
FIVE: Any = 5
BYTES: Any = b"tcp/127.0.0.1:7447"


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller(DEMO_LIBRARY, gate=GATE) as opened:
        yield opened


def reference(controller: Controller) -> np.ndarray[Any, np.dtype[np.float64]]:
    s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
    return np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: VehicleClient.connect(NOTHING, gate=GATE), "endpoints: expected a text .*None"),
        (lambda: VehicleClient.connect(FIVE, gate=GATE), "endpoints: expected a text .* int"),
        (lambda: VehicleClient.connect(BYTES, gate=GATE), "endpoints: expected a text .* bytes"),
        (lambda: VehicleClient.connect([FIVE], gate=GATE), "endpoints: expected a text .* int"),
        (lambda: VehicleClient.connect(NOBODY, gate=NOTHING), "gate: expected a mapping .*None"),
        (lambda: Controller(DEMO_LIBRARY, gate=FIVE), "gate: expected a mapping .* int"),
        (lambda: FleetMap(NOBODY, NOTHING, road="r", vehicle="v"), "RoadBelief"),
        (
            lambda: FleetMap(FIVE, NOTHING, road="r", vehicle="v"),
            "endpoints: expected a text .* int",
        ),
        (lambda: StatusPublisher(NOTHING), "controller: expected StepController, .*None"),
        (lambda: TrackEnvironment(NOTHING), "NoneType"),
        (lambda: Recorder("none.mcap", NOTHING), "controller: expected StepController, .*None"),
    ],
)
def test_an_argument_of_another_type_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Callable[[], Any], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TypeError, match=message):
        call()
    assert not list(tmp_path.iterdir())


def test_a_recorder_names_the_argument_that_it_cannot_record(
    tmp_path: Path, controller: Controller
) -> None:
    step = controller.step(X, reference(controller))
    with pytest.raises(TypeError, match=r"notes: expected Mapping, .* int"):
        Recorder(tmp_path / "a.mcap", controller, notes=FIVE)
    text: Any = "a"
    with Recorder(tmp_path / "a.mcap", controller) as recorder:
        with pytest.raises(TypeError, match=r"step: expected Step, .*None"):
            recorder.add(NOTHING, X, 0.0)
        with pytest.raises(TypeError, match=r"time: expected Real, .* str"):
            recorder.add(step, X, text)
        recorder.add(step, X, np.float32(0.5))  # type: ignore[arg-type]
    assert len(read_recording(tmp_path / "a.mcap").steps) == 1


def test_an_interruption_while_an_argument_is_read_is_no_error_of_the_argument(
    controller: Controller,
) -> None:
    class Interrupted:
        def __array__(self, *_: object, **__: object) -> NoReturn:
            raise KeyboardInterrupt

    state: Any = Interrupted()
    with pytest.raises(KeyboardInterrupt):
        controller.step(state, reference(controller))
    assert controller.step(X, reference(controller)).mode == "normal"


def test_a_gate_is_any_mapping() -> None:
    for gate in (MappingProxyType(GATE), UserDict(GATE)):
        with Controller(DEMO_LIBRARY, gate=gate) as opened:
            assert opened.step(X, reference(opened)).mode == "normal"


def test_what_describes_a_control_step_cannot_be_changed(controller: Controller) -> None:
    described: Any = controller
    with pytest.raises(TypeError, match="does not support item assignment"):
        described.settings["cost"]["lateral"] = 1.0
    with pytest.raises(TypeError, match="does not support item assignment"):
        described.settings["cost"]["rate"][1] = 1.0
    with pytest.raises(AttributeError, match="dt of a controller cannot be changed"):
        described.dt = 3.0
    assert controller.dt == 0.02


def test_a_controller_is_not_copied(controller: Controller) -> None:
    for copied in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match="Controller cannot be pickled or copied"):
            copied(controller)


def test_an_environment_takes_the_path_of_a_scenario(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(
        'name = "own"\n[track]\nkind = "circle"\n[[zones]]\nstart = 0.0\nfriction = 1.0\n',
        encoding="utf-8",
    )
    environment = TrackEnvironment(file)
    environment.reset(seed=0)
    action: Any = "a"
    with pytest.raises(InvalidArgumentError, match=r"expected an action of shape \(2,\)"):
        environment.step(action)
    assert load_scenario(str(file)).name == "own"
