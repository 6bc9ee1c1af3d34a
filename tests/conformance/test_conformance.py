"""The same schedules over every transport: one driver, so one behaviour."""

from __future__ import annotations

import time
import tomllib
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from conformance.vehicles import (
    DEADLINE,
    FLEET,
    GATE,
    VEHICLE,
    ConnectError,
    InProcess,
    Outcome,
    OverZenohInPython,
    OverZenohInRust,
)
from egp_service._core import Discovery, decode_request

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from conformance.replica import Script
    from conformance.vehicles import Vehicle

SCHEDULES = tomllib.loads((Path(__file__).parent / "schedules.toml").read_text(encoding="utf-8"))
TRANSPORTS: dict[str, Callable[[Mapping[str, Script], float], Vehicle]] = {
    "in-process": InProcess,
    "zenoh-python": OverZenohInPython,
    "zenoh-rust": OverZenohInRust,
}
SPEED = 15.0
PATIENCE = 30.0
# While all replicas are frozen no answer can come. Three such periods take 0.2 s, a lease 2 s.
FROZEN_DEADLINE = 0.06
# More than a tail, less than the time after which zenoh closes a link.
HELD_UP_PERIODS = 40


def named_by_preference() -> dict[str, str]:
    """Names of the two replicas: the one that the vehicle asks first, and the other."""
    discovery = Discovery(fleet=FLEET, vehicle=VEHICLE, gate=GATE)
    for name in ("north", "south"):
        discovery.replica_appeared(name)
    questions = [discovery.next_question(), discovery.next_question()]
    names = [question[0] for question in questions if question is not None]
    return dict(zip(("first", "second"), names, strict=True))


def measured(
    vehicle: Vehicle, state: dict[str, list[int]], period: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """State and reference of one period on a straight road, as the schedule changes them."""
    s = SPEED * vehicle.dt * np.arange(vehicle.horizon + 1)
    zero = np.zeros_like(s)
    reference = np.column_stack([s, zero, zero + SPEED, zero])
    x = np.array([0.0, 0.3, SPEED, 0.0, 0.0, 0.0, 0.0])
    for change in (name for name, periods in state.items() if period in periods):
        match change:
            case "short_reference":
                reference = reference[:-1]
            case "yaw_in_degrees":
                reference = np.column_stack([-s, zero, zero + SPEED, zero + 180.0])
                x[3] = np.pi
            case "far_reference":
                reference[:, 1] += 100.0
            case "spin":
                x[4] = -9.0
            case "rolling_back":
                x[2] = -1.5
            case "not_finite":
                x[2] = np.nan
            case "nowhere":
                x[0] = np.nan
                reference[:, 0] = np.nan
            case _:
                raise ValueError(change)
    return x, reference


def befall(vehicle: Vehicle, schedule: dict[str, Any], period: int) -> None:
    """Do to the vehicle itself what the schedule says for the time before a period."""
    if period in schedule.get("reset_before", []):
        vehicle.reset()
    if period == schedule.get("held_up_before"):
        vehicle.hold_up(HELD_UP_PERIODS * vehicle.dt)


def run(vehicle: Vehicle, schedule: dict[str, Any], names: dict[str, str]) -> list[Outcome]:
    """Drive the schedule, and over zenoh on until the replica answers that is to answer last."""
    outcomes: list[Outcome] = []
    frozen: set[str] = set()
    last_replica = names.get(schedule["expect"].get("last_answered_by"))
    late = time.monotonic() + PATIENCE

    def goes_on() -> bool:
        if len(outcomes) < schedule["periods"]:
            return True
        if last_replica is None or isinstance(vehicle, InProcess):
            return False
        return outcomes[-1].replica != last_replica and time.monotonic() < late

    while goes_on():
        period, begun = len(outcomes) + 1, time.monotonic()
        for replica, (first, last) in schedule.get("freeze", {}).items():
            if period == first:
                vehicle.freeze(names[replica])
                frozen.add(replica)
            if period == last:
                vehicle.thaw(names[replica])
                frozen.discard(replica)
        befall(vehicle, schedule, period)
        x, reference = measured(vehicle, schedule.get("state", {}), period)
        all_frozen = len(frozen) == schedule.get("replicas", 2)
        deadline = FROZEN_DEADLINE if all_frozen else DEADLINE
        outcomes.append(vehicle.step(x, reference, deadline))
        if "freeze" in schedule and not isinstance(vehicle, InProcess):
            time.sleep(max(0.0, vehicle.dt - (time.monotonic() - begun)))
    return outcomes


def check(expected: dict[str, Any], outcomes: list[Outcome], names: dict[str, str]) -> None:
    """Compare the outcomes with those that the schedule expects."""
    story = "\n".join(f"{period}: {outcome}" for period, outcome in enumerate(outcomes, 1))
    modes = Counter(outcome.mode for outcome in outcomes if not outcome.error)
    statuses = Counter(outcome.status for outcome in outcomes if not outcome.error)
    answered = Counter(outcome.replica for outcome in outcomes if outcome.status == "solved")
    if "modes" in expected:
        assert modes == expected["modes"], story
    for mode, most in expected.get("modes_at_most", {}).items():
        assert modes[mode] <= most, story
    if "statuses" in expected:
        assert statuses == expected["statuses"], story
    if "answered_by" in expected:
        assert answered == {names[who]: n for who, n in expected["answered_by"].items()}, story
    if "last_answered_by" in expected:
        assert outcomes[-1].replica == names[expected["last_answered_by"]], story
    if "last_mode" in expected:
        assert outcomes[-1].mode == expected["last_mode"], story
    errors = {str(period): o.error for period, o in enumerate(outcomes, 1) if o.error}
    assert errors.keys() == expected.get("errors", {}).keys(), story
    for period, words in expected.get("errors", {}).items():
        assert words in errors[period], story
    lost = [period for period, outcome in enumerate(outcomes, 1) if outcome.lost]
    assert lost == expected.get("lost", []), story
    for period in expected.get("fresh_request", []):
        request = decode_request(outcomes[period - 1].request)
        assert (len(request.plan_u), len(request.history_z), len(request.weights)) == (0, 0, 0)
    for period in expected.get("request_after_gap", []):
        before, request = (decode_request(outcomes[k].request) for k in (period - 2, period - 1))
        assert request.sequence - before.sequence >= HELD_UP_PERIODS, story
        assert (len(request.plan_u), len(request.history_z), len(request.weights)) == (0, 0, 2)


@pytest.mark.parametrize("schedule", SCHEDULES["schedule"], ids=lambda schedule: schedule["name"])
@pytest.mark.parametrize("transport", TRANSPORTS)
def test_every_transport_behaves_the_same(transport: str, schedule: dict[str, Any]) -> None:
    names = named_by_preference()
    present = list(names.values())[: schedule.get("replicas", 2)]
    faults = schedule.get("faults", {})
    scripts = {names[who]: faults.get(who, {}) for who in names if names[who] in present}
    assert schedule["expect"], "a schedule must expect something"
    if "not_connected" in schedule["expect"]:
        with pytest.raises(ConnectError) as caught:
            TRANSPORTS[transport](scripts, schedule["patience"])
        for who, reason in schedule["expect"]["not_connected"].items():
            assert f"replica {names[who]}: {reason}" in str(caught.value)
        return
    vehicle = TRANSPORTS[transport](scripts, schedule.get("patience", 10.0))
    try:
        outcomes = run(vehicle, schedule, names)
    finally:
        vehicle.close()
    check(schedule["expect"], outcomes, names)
