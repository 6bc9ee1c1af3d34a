"""The golden messages as Google's protobuf reads and writes them: a second implementation."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from egp_service import _core
from egp_service._core import testing

if TYPE_CHECKING:
    from numpy.typing import NDArray

GOLDEN = Path(__file__).parents[1] / "golden"
LIBRARY = b"0123456789abcdef" * 2


def golden(name: str) -> bytes:
    return (GOLDEN / f"wire_{name}.bin").read_bytes()


@cache
def message(name: str) -> Any:  # noqa: ANN401 - classes made at run time
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(_core.file_descriptor_set()).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"egp.v1.{name}"))


def ramp(shape: tuple[int, ...], start: float, step: float) -> NDArray[np.float64]:
    """Give the values `rust/testing/src/messages.rs` numbers a field with."""
    count = int(np.prod(shape))
    return start + step * np.arange(count, dtype=np.float64).reshape(shape)


def tensor(values: NDArray[np.float64]) -> dict[str, Any]:
    return {"shape": values.shape, "data": values.astype("<f8").tobytes()}


def fill(values: dict[str, Any]) -> dict[str, Any]:
    return {k: tensor(v) if isinstance(v, np.ndarray) else v for k, v in values.items()}


COLD = {
    "version": 1,
    "library": LIBRARY,
    "sequence": 1,
    "budget_us": 40_000,
    "x": np.array([1.0, 1.125, 1.25, 1.375, 1.5, 1.625, 0.5]),
    "u_prev": np.array([-2048.5, 0.25]),
    "reference": ramp((5, 4), 10.0, 0.5),
}
FULL = COLD | {
    "sequence": 7,
    "weights": np.array([0.75, 0.25]),
    "plan_x": ramp((5, 7), -1.0, 0.0625),
    "plan_u": ramp((4, 2), 2.0, 0.125),
    "plan_shift": 1,
    "history_z": ramp((3, 6), -0.5, 0.0625),
    "history_y": ramp((3, 3), -0.25, 0.03125),
    "history_f": ramp((2, 2, 3), -0.125, 0.015625),
    "widths": ramp((5, 2), 3.0, 0.25),
    "want_sigma": True,
    "road_friction": ramp((6, 2), 0.25, 0.125),
}
FRICTION = {
    "mean": 0.625,
    "std": 0.125,
    "lower": 0.5,
    "upper": 0.75,
    "information": 1.5,
    "log_likelihood": [-0.25 * i for i in range(17)],
    "misfit": 0.375,
}
INFEASIBLE = {
    "version": 1,
    "library": LIBRARY,
    "sequence": 7,
    "status": "STATUS_INFEASIBLE",
    "weights": np.array([0.625, 0.375]),
    "history_f": ramp((3, 2, 3), 0.25, 0.015625),
    "dropped_mass": 2.0**-10,
    "iterations": 9,
    "kkt_residual": 2.0**-30,
    "solver": "clarabel",
    "friction": FRICTION,
}
SOLVED = INFEASIBLE | {
    "status": "STATUS_SOLVED",
    "plan_x": ramp((5, 7), -1.0, 0.0625),
    "plan_u": ramp((4, 2), -1.0, 0.125),
    "sigma": ramp((5, 3), 0.0, 0.0625),
}
ERROR = {"code": "CODE_INVALID_FIELD", "field": "x", "detail": "value 3 is not finite"}
# 1, 2, ... 16 in the order of the message, but for the sign of a_min.
VEHICLE = {
    "mass": 1500.0,
    "yaw_inertia": 2500.0,
    "l_f": 1.25,
    "l_r": 1.75,
    "width": 2.0,
    "a_min": -6.0,
    "a_max": 7.0,
    "power": 80.0,
    "a_slew": 90.0,
    "steering_angle": 0.5,
    "steering_rate": 0.75,
    "steering_slew": 12.0,
    "peak_slip": 0.125,
    "lateral_grip": 1.5,
    "braking_grip": 2.25,
    "driving_grip": 3.5,
}
READY = {
    "version": 1,
    "ready": True,
    "library": LIBRARY,
    "dt": 0.05,
    "horizon": 20,
    "history": 10,
    "members": ["dry", "wet"],
    "envelope": np.array(
        [[1.0, -5.0, -1.5, -0.5, -8192.0, -0.5], [30.0, 5.0, 1.5, 0.5, 4096.0, 0.5]]
    ),
    "vehicle": VEHICLE,
}
TIMING = {"queue_us": 120, "step_us": 2400}
SEAL = {
    "fleet": "depot",
    "vehicle": "car-7",
    "run": 1 << 60,
    "number": 77,
    "tag": bytes(range(32)),
}


@pytest.mark.parametrize(
    ("file", "kind", "values"),
    [
        ("request_full", "StepRequest", FULL),
        ("request_cold", "StepRequest", COLD),
        ("reply_solved", "StepReply", SOLVED),
        ("reply_infeasible", "StepReply", INFEASIBLE),
        ("error", "Error", ERROR),
        ("ready", "Ready", READY),
        ("seal", "Seal", SEAL),
        ("timing", "Timing", TIMING),
    ],
)
def test_google_protobuf_reads_and_writes_the_golden_bytes(
    file: str, kind: str, values: dict[str, Any]
) -> None:
    expected = message(kind)(**fill(values))
    assert message(kind).FromString(golden(file)) == expected
    assert expected.SerializeToString(deterministic=True) == golden(file)


@pytest.mark.parametrize(("file", "values"), [("request_full", FULL), ("request_cold", COLD)])
def test_the_extension_reads_requests(file: str, values: dict[str, Any]) -> None:
    request = _core.decode_request(golden(file))
    for field, value in values.items():
        if field != "version":
            np.testing.assert_array_equal(getattr(request, field), value)


def test_the_extension_reads_replies() -> None:
    reply = _core.decode_reply(golden("reply_solved"))
    assert reply.status == "solved"
    for field in SOLVED.keys() - {"version", "status", "friction"}:
        np.testing.assert_array_equal(getattr(reply, field), SOLVED[field])
    for field, value in FRICTION.items():
        np.testing.assert_array_equal(getattr(reply.friction, field), value)
    assert _core.decode_reply(golden("reply_infeasible")).plan_u.shape == (0, 2)


def test_the_extension_reads_the_small_messages() -> None:
    refusal = testing.decode_error(golden("error"))
    assert (refusal.code, refusal.field, refusal.retryable) == ("invalid_field", "x", False)
    ready = _core.decode_ready(golden("ready"))
    for field in READY.keys() - {"version", "vehicle"}:
        np.testing.assert_array_equal(getattr(ready, field), READY[field])
    assert ready.vehicle is not None
    assert ready.vehicle.fields() == VEHICLE
    assert ready.vehicle == _core.VehicleParameters(**VEHICLE)
    assert testing.decode_timing(golden("timing")) == (120, 2400)


def test_a_client_in_another_language_is_told_which_field_is_wrong() -> None:
    request = message("StepRequest")(**fill(FULL | {"weights": np.array([0.75, 0.75])}))
    with pytest.raises(_core.EgpError, match=r"weights: weights sum to 1\.5"):
        _core.decode_request(request.SerializeToString())


def test_the_driver_makes_requests_that_google_protobuf_reads() -> None:
    gate = _core.VehicleParameters(**VEHICLE).gate_limits()
    driver = _core.Driver(golden("ready"), fleet="depot", vehicle="car-7", gate=gate)
    driver.replica_appeared("garage-1")
    driver.replica_fits("garage-1")
    reference = np.zeros((21, 4))
    reference[:, 0] = 0.5 * np.arange(21)
    requests, forces = [], []
    for tick, v_x in enumerate((10.0, 10.5)):
        driver.tick(0.05 * tick, 0.05 * tick + 0.04, np.array([0, 0, v_x, 0, 0, 0, 0]), reference)
        query = driver.next_action()
        assert isinstance(query, _core.Query)
        assert query.key == "egp/v1/r/garage-1/depot/car-7/step"
        requests.append(message("StepRequest").FromString(query.payload))
        driver.wake(0.05 * tick + 0.04)
        decision = driver.next_action()
        assert isinstance(decision, _core.Decision)
        assert (decision.mode, decision.status) == ("waiting", "late")
        forces.append(decision.u[0])
    history = requests[1].history_z
    assert list(history.shape) == [1, 6]
    assert np.frombuffer(history.data, "<f8").tolist() == [10.0, 0.0, 0.0, 0.0, forces[0], 0.0]
    assert [request.budget_us for request in requests] == [40_000, 40_000]
    with pytest.raises(_core.InvalidArgumentError, match="reference: expected 21 rows"):
        driver.tick(1.0, 1.04, np.zeros(7), reference[:1])
