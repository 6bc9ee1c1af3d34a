"""Arguments that cannot be used: each is an error in words, and nothing is lost."""

from __future__ import annotations

import threading
import tomllib
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest

from egp_service import (
    Controller,
    EgpError,
    InvalidArgumentError,
    Library,
    Path,
    Plant,
    Recorder,
    RoadBelief,
    SpeedPlanner,
    SpeedProfile,
    StatusPublisher,
    VehicleClient,
)
from egp_service._core import (
    Decision,
    Driver,
    Engine,
    Query,
    decode_request,
    merge_tiles,
    solve_weights,
)
from egp_service.control.fleet_map import FleetMap
from egp_service.control.recorded import read_recording
from egp_service.control.toml_text import dumps
from egp_service.shipped import DEMO_LIBRARY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path as FilePath

    from numpy.typing import ArrayLike

    from egp_service import Step

PATH = Path.rounded_rectangle()
CAR = Plant().parameters
GATE = CAR.gate_limits()
NOBODY = "tcp/127.0.0.1:9"
X = [0.0, 0.1, 15.0, 0.0, 0.0, 0.0, 0.0]
NAN, INF = float("nan"), float("inf")
NOTHING: Any = None


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller(DEMO_LIBRARY, gate=GATE) as opened:
        yield opened


def step(controller: Controller, deadline: float | None = None) -> Step:
    s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
    reference = np.column_stack([s, 0 * s, 0 * s + 20.0, 0 * s])
    return controller.step(X, reference, deadline=deadline)


def belief() -> RoadBelief:
    return RoadBelief(PATH)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: PATH.sample([0.0, NAN]), "arc lengths s, got NaN at index 1"),
        (lambda: SpeedProfile(PATH, CAR).speed([INF]), "arc lengths s, got inf at index 0"),
        (lambda: SpeedPlanner(PATH, CAR).places(NAN), "arc length s in m, got NaN"),
        (lambda: belief().ahead([0.0, 1.0, 100.0], 0.05), "equal distances.* 99 m from 1 to 100"),
        (lambda: belief().ahead([0.0, 1.0, NAN], 0.05), "equal distances"),
        (lambda: belief().recall(belief().to_bytes(), NAN), "for age, got NaN"),
        (lambda: belief().recall(belief().to_bytes(), -1.0), "for age, got -1"),
        (lambda: merge_tiles([(belief().tile(0), NAN)]), "for age, got NaN"),
        (lambda: Library.load(DEMO_LIBRARY).predict([[NAN] * 6]), "finite inputs z.* in row 0"),
        (lambda: Library.load(DEMO_LIBRARY).predict([[1e160] * 6]), "row 0 of z is too large"),
        (lambda: Library.load(DEMO_LIBRARY).predict_mean([[1e160] * 6]), "row 0 of z is too"),
        (lambda: PATH.sample([[0.0]]), r"with 1 dimension, got the shape \(1, 1\)"),
        (lambda: PATH.sample("far"), "with 1 dimension, got the type <U3"),
        (lambda: PATH.sample(["0", "1"]), "got the type <U1"),
        (lambda: PATH.sample([0.0, NOTHING]), "got the type object"),
        (lambda: PATH.sample([[0.0], [0.0, 1.0]]), "got list: "),
        (lambda: Path.from_points([1.0, 2.0], closed=False), r"2 dimensions, got the shape \(2,\)"),
        (
            lambda: Controller(DEMO_LIBRARY, NOTHING, gate=GATE),
            "settings: expected TOML.* got None",
        ),
        (lambda: Controller(DEMO_LIBRARY, gate={}), "gate limit mass is missing"),
        (lambda: VehicleClient.connect([], gate=GATE), "endpoints: expected at least one"),
        (lambda: VehicleClient.connect(NOBODY, gate={}), "gate limit mass is missing"),
        (lambda: VehicleClient.connect(NOBODY, gate=GATE, timeout=INF), "for timeout, got inf"),
        (lambda: VehicleClient.connect(NOBODY, gate=GATE, timeout=NAN), "for timeout, got nan"),
        (
            lambda: VehicleClient.connect(NOBODY, gate=GATE, timeout=-1.0),
            "expected 0 to 86400 seconds for timeout, got -1",
        ),
        (
            lambda: Controller(DEMO_LIBRARY, " softer.toml\n", gate=GATE),
            "got the path ' softer.toml",
        ),
        (
            lambda: VehicleClient.connect(NOBODY, gate=GATE, key_file="no.keys"),
            r"no\.keys.*egp keys",
        ),
        (lambda: FleetMap(NOBODY, belief(), road="", vehicle="v"), '"" is no name of .* or road'),
        (
            lambda: FleetMap(NOBODY, belief(), road="r", vehicle="v", lifetime=0.0),
            "for lifetime, got 0$",
        ),
    ],
)
def test_what_cannot_be_used_is_named(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(InvalidArgumentError, match=message):
        call()


@pytest.mark.parametrize("prior", ["quadratic", "l1"])
def test_errors_whose_squares_are_no_numbers_give_no_weights(
    prior: Literal["quadratic", "l1"],
) -> None:
    predictions = np.full((2, 2, 3), 1e200)
    with pytest.raises(EgpError, match="too large for a number"):
        solve_weights(predictions, np.zeros((2, 3)), [0.1] * 3, [0.5, 0.5], prior, 1.0)


@pytest.mark.parametrize("prior", ["quadratic", "l1"])
def test_a_strength_of_the_prior_that_is_too_large_is_named(
    prior: Literal["quadratic", "l1"],
) -> None:
    predictions = np.array([[[0.1, 0.0, 0.0], [0.3, 0.0, 0.0]]])

    measured, noise, previous = [[0.2, 0.0, 0.0]], [0.01] * 3, [0.9, 0.1]
    w = solve_weights(predictions, measured, noise, previous, prior, 1e300)
    np.testing.assert_allclose(w, previous, rtol=1e-12)
    for strength in (1.7e308, -1.0, np.inf, np.nan):
        with pytest.raises(EgpError, match="strength must be a number from 0 to 1e300"):
            solve_weights(predictions, measured, noise, previous, prior, strength)


def test_the_argument_is_in_a_note() -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        PATH.project([[1.0, 2.0]])
    assert caught.value.__notes__ == ["while processing 'position'"]


def test_lists_and_numbers_of_other_types_are_arrays() -> None:
    exact = PATH.sample(np.array([0.0, 30.0]))
    for s in ([0, 30], (0.0, 30.0), np.array([0, 30]), np.array([0.0, 30.0], np.float32)):
        np.testing.assert_array_equal(PATH.sample(s), exact)


@pytest.mark.parametrize("reference", [[], NOTHING, np.zeros((41, 3)), np.zeros((0, 4)), "no"])
def test_a_state_that_cannot_be_used_is_a_stop_whatever_its_reference_is(
    controller: Controller, reference: ArrayLike
) -> None:
    step(controller)
    stopped = controller.step([NAN] * 7, reference, reference, road_friction=reference)
    assert (stopped.mode, stopped.status) == ("stop", "invalid_state")
    driver = described_driver(controller)
    driver.tick(0.02, 0.036, [NAN] * 7, reference, reference, reference)
    decision = driver.next_action()
    assert isinstance(decision, Decision)
    assert (decision.mode, decision.status) == ("stop", "invalid_state")


def described_driver(controller: Controller) -> Driver:
    """Return the driver of a vehicle on the network."""
    engine = Engine(str(controller.library_file))
    driver = Driver(engine.ready, fleet="depot", vehicle="car-7", gate=GATE)
    driver.replica_appeared("garage-1")
    driver.replica_fits("garage-1")
    return driver


@pytest.mark.parametrize("wrong", ["reference", "widths", "road_friction", "x"])
def test_a_period_with_an_argument_of_the_wrong_shape_counts(
    controller: Controller, wrong: str
) -> None:
    s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
    straight = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
    good: dict[str, Any] = {"x": X, "reference": straight}
    bad = good | {wrong: np.zeros((5, 5))}
    for _ in range(3):
        before = decode_request(controller.step(**good).request)
    assert len(before.history_z) == 2
    with pytest.raises(InvalidArgumentError, match=wrong) as caught:
        controller.step(**bad)
    if wrong == "x":
        assert caught.value.__notes__ == ["while processing 'x'"]
    after = decode_request(controller.step(**good).request)
    assert after.sequence == before.sequence + 2
    assert (after.plan_shift, len(after.history_z)) == (2, 0)
    driver = described_driver(controller)
    for tick in (1, 2):
        driver.tick(0.02 * tick, 0.02 * tick + 0.016, **good)
        driver.wake(0.02 * tick + 0.016)
    with pytest.raises(InvalidArgumentError, match=wrong):
        driver.tick(0.06, 0.076, **bad)
    driver.tick(0.08, 0.096, **good)
    query = driver.next_action()
    assert isinstance(query, Query)
    after = decode_request(query.payload)
    assert (after.sequence, len(after.history_z)) == (4, 0)


@pytest.mark.parametrize("name", ["widths", "road_friction"])
def test_an_array_without_rows_is_not_the_same_as_none(controller: Controller, name: str) -> None:
    s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
    straight = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
    stated: dict[str, Any] = {name: np.zeros((0, 2))}
    with pytest.raises(InvalidArgumentError, match=f"{name}: expected a row for each stage"):
        controller.step(X, straight, **stated)
    with pytest.raises(InvalidArgumentError, match=f"{name}: expected a row for each stage"):
        described_driver(controller).tick(0.02, 0.036, X, straight, **stated)
    assert controller.step(X, straight, **{name: None}).mode == "normal"


def test_a_plan_that_no_message_may_contain_is_none(controller: Controller) -> None:
    # A vehicle that spins far outside the members' data; the plan would slide at 630 m/s.
    spinning = np.array([0.0, 0.0, 56.62, 0.0, -5.01, 3.98, -0.11])
    s = 57.0 * controller.dt * np.arange(controller.horizon + 1)
    reference = np.column_stack([s, 0 * s, 0 * s + 57.0, 0 * s])
    found = controller.step(spinning, reference)
    assert (found.status, found.reply is not None) == ("check_failed", True)
    assert len(found.weights) == 2
    assert "no vehicle reaches" in found.detail


def test_who_states_no_endpoint_states_a_configuration(controller: Controller) -> None:
    for port, connect in (
        (7447, lambda: VehicleClient.connect([], gate=GATE)),
        (7448, lambda: FleetMap([], belief(), road="r", vehicle="v")),
        (7450, lambda: StatusPublisher(controller, [])),
    ):
        with pytest.raises(InvalidArgumentError, match=f"at least one, such as 'tcp/.*:{port}'"):
            connect()
    StatusPublisher(controller, [], zenoh_config={"mode": "peer"}).close()


def test_names_of_a_publication_are_checked(controller: Controller) -> None:
    with pytest.raises(InvalidArgumentError, match='"a/b" is no name'):
        StatusPublisher(controller, vehicle="a/b")


def test_a_deadline_that_is_over_still_gives_a_plan(controller: Controller) -> None:
    for deadline in (0.0, -1.0):
        assert step(controller, deadline).mode == "normal"
    before = decode_request(step(controller).request).sequence
    for deadline in (NAN, INF):
        with pytest.raises(InvalidArgumentError, match="finite deadline"):
            step(controller, deadline)
    assert decode_request(step(controller).request).sequence == before + 3, "each period counts"


def test_a_period_whose_deadline_cannot_be_used_counts(controller: Controller) -> None:
    driver = described_driver(controller)
    s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
    reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
    sequences = []
    for period, deadline in enumerate([0.016, NAN, INF, 0.076]):
        if not np.isfinite(deadline):
            with pytest.raises(InvalidArgumentError, match="finite deadline"):
                driver.tick(0.02 * period, deadline, X, reference)
            continue
        driver.tick(0.02 * period, deadline, X, reference)
        query = driver.next_action()
        assert isinstance(query, Query)
        sequences.append(decode_request(query.payload).sequence)
    assert sequences == [1, 4]


def test_a_closed_controller_takes_no_step() -> None:
    with Controller(DEMO_LIBRARY, gate=GATE) as closed:
        assert step(closed).mode == "normal"
    with pytest.raises(EgpError, match="the controller was closed: make another one"):
        step(closed)


@pytest.mark.parametrize("before", ["", "# of the wet car\n"])
def test_text_of_settings_may_end_with_the_name_of_a_file(before: str) -> None:
    text = f"{before}cost.lateral = 20.0  # as in softer.toml"
    with Controller(DEMO_LIBRARY, text, gate=GATE) as stated:
        assert stated.stated_settings == {"cost": {"lateral": 20.0}}


def test_a_reset_keeps_the_input_that_the_actuators_apply(controller: Controller) -> None:
    applied = [step(controller).u.tolist() for _ in range(3)][-1]
    controller.reset()
    request = decode_request(step(controller).request)
    assert request.u_prev.tolist() == applied
    assert len(request.plan_u) == 0


def test_another_thread_may_reset(controller: Controller) -> None:
    failed: list[BaseException] = []
    ended = threading.Event()

    def reset() -> None:
        while not ended.is_set():
            try:
                controller.reset()
            except BaseException as error:  # noqa: BLE001 - the test shows whatever comes
                failed.append(error)

    other = threading.Thread(target=reset)
    other.start()
    try:
        assert {step(controller).mode for _ in range(20)} == {"normal"}
    finally:
        ended.set()
        other.join()
    assert not failed


@pytest.mark.parametrize("time", [-0.02, NAN, INF, 1e10])
def test_a_recording_is_complete_after_a_wrong_time(
    controller: Controller, tmp_path: FilePath, time: float
) -> None:
    file = tmp_path / "run.mcap"
    with Recorder(file, controller) as recorder:
        for k in range(3):
            recorder.add(step(controller), X, 0.02 * k)
            with pytest.raises(InvalidArgumentError, match="seconds since the start"):
                recorder.add(step(controller), X, time)
            with pytest.raises(InvalidArgumentError, match=r"x has shape \(6,\)"):
                recorder.add(step(controller), X[:6], 0.02 * k)
    assert len(read_recording(file).steps) == 3
    with pytest.raises(InvalidArgumentError, match="because it is closed"):
        recorder.add(step(controller), X, 1.0)


def test_numbers_and_arrays_of_numpy_are_settings() -> None:
    table = {"a": np.float64(30.0), "b": np.int32(3), "c": np.arange(2.0), "d": np.bool_(1)}
    assert dumps(table) == "a = 30.0\nb = 3\nc = [0.0, 1.0]\nd = true\n"
    assert tomllib.loads(dumps({"a": np.float32(0.5)})) == {"a": 0.5}
    with pytest.raises(EgpError, match=r"texts as names.* got 1"):
        dumps({"a": {1: 2}})


def test_a_state_outside_its_domain_is_named_with_unit_and_range(controller: Controller) -> None:
    s = 15.0 * controller.dt * np.arange(controller.horizon + 1)
    reference = np.column_stack([s, 0 * s, 0 * s + 15.0, 0 * s])
    stopped = controller.step([*X[:4], 60.0, *X[5:]], reference)
    assert stopped.status == "invalid_state"
    assert "v_y = 60 m/s is outside -50 to 50 m/s" in stopped.detail
