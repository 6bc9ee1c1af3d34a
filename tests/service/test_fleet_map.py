"""The vehicle's side of the fleet's map, with a service that answers what a test wants."""

from __future__ import annotations

import json
import time
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from egp_service._core import RoadBelief
from egp_service.control import fleet_map
from egp_service.control.endpoints import free_endpoint
from egp_service.control.fleet_map import FleetMap
from egp_service.control.messages import message_class
from egp_service.control.session import session_config
from patience import wait_until
from road_evidence import PATH, measure, measured

TILE = measured(0.5).tile(0)


def test_evidence_that_is_too_old_for_a_message_is_dropped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    belief, now = RoadBelief(PATH), 100.0
    clock = SimpleNamespace(monotonic=lambda: now, sleep=time.sleep)
    monkeypatch.setattr(fleet_map, "time", clock)
    with FleetMap(free_endpoint(), belief, road="r", vehicle="v", timeout=0.1) as fleet:
        measure(belief, 0.4, 150.0)
        assert fleet.unsent == 2
        now += 50 * 86_400.0
        fleet.exchange()
        assert fleet.unsent == 0


def test_a_lost_answer_is_asked_for_again_while_the_vehicle_waits() -> None:
    endpoint = free_endpoint()
    lost: list[zenoh.Query] = []
    answered = 0

    def answer(query: zenoh.Query) -> None:
        nonlocal answered
        if lost:
            query.reply(query.key_expr, b"")
            answered += 1
        else:
            lost.append(query)  # a query that is kept has no end

    with zenoh.open(session_config([], 5.0, {"listen/endpoints": [endpoint]})) as session:
        queryable = session.declare_queryable("egp/**", answer)
        with FleetMap(endpoint, RoadBelief(PATH), road="r", vehicle="v", timeout=6.0) as fleet:
            assert not fleet.answered
            assert fleet.fetch()
            assert fleet.answered
        assert answered == 1
        lost.clear()
        queryable.undeclare()


def test_evidence_that_an_overloaded_service_refused_is_sent_again() -> None:
    endpoint = free_endpoint()
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    asked: list[str] = []

    def answer(query: zenoh.Query) -> None:
        key = str(query.key_expr)
        asked.append(key)
        if asked.count(key) == 1:
            query.reply_err(bytes([0x08, 5, 0x10, 1]))  # code OVERLOADED, retryable
        else:
            query.reply(key, b"")

    with zenoh.open(config) as session:
        queryable = session.declare_queryable("egp/**", answer)
        belief = RoadBelief(PATH)
        with FleetMap(endpoint, belief, road="ring", vehicle="car") as fleet:
            assert fleet.fetch()
            measure(belief, 0.4, 150.0)
            (question,) = set(asked)
            assert len(asked) == 2

            def sent_again() -> bool:
                fleet.exchange()
                return sorted(map(asked.count, set(asked) - {question})) == [2, 2]

            wait_until(sent_again)
        queryable.undeclare()  # type: ignore[no-untyped-call]


def test_a_service_that_accepts_no_evidence_now_is_there_and_gets_the_last_one(
    caplog: pytest.LogCaptureFixture,
) -> None:
    endpoint = free_endpoint()
    offered = []

    def answer(query: zenoh.Query) -> None:
        if "/tile/" in str(query.key_expr):
            offered.append(query.key_expr)
            query.reply_err(bytes([0x08, 5, 0x10, 1]))  # code OVERLOADED, retryable
        else:
            query.reply(str(query.key_expr), b"")

    with zenoh.open(session_config([], 5.0, {"listen/endpoints": [endpoint]})) as session:
        queryable = session.declare_queryable("egp/**", answer)
        belief = RoadBelief(PATH)
        with FleetMap(endpoint, belief, road="ring", vehicle="car") as fleet:
            assert fleet.fetch()
            measure(belief, 0.4, 150.0)

            def refused() -> bool:
                fleet.exchange()
                return "does not accept evidence" in caplog.text

            wait_until(refused)
            before = len(offered)
        queryable.undeclare()  # type: ignore[no-untyped-call]
    assert len(offered) > before
    assert fleet.unsent == 2
    assert not fleet.silent
    assert "no map service answers" not in caplog.text


def test_no_query_waits_for_a_full_link_and_few_tiles_are_sent_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fleet_map, "_SENDING", 1)
    belief, asked = RoadBelief(PATH), list[dict[str, object]]()
    with FleetMap(free_endpoint(), belief, road="r", vehicle="v", timeout=0.1) as fleet:
        session = SimpleNamespace(
            get=lambda _key, _handler, **options: asked.append(options),
            close=fleet._session.close,  # noqa: SLF001
        )
        monkeypatch.setattr(fleet, "_session", session)
        measure(belief, 0.4, 150.0)
        for _ in range(3):
            fleet._send()  # noqa: SLF001
        assert fleet.unsent == 2
        (options,) = asked
        assert options["congestion_control"] == zenoh.CongestionControl.DROP


def answer_with_a_tile(query: zenoh.Query) -> None:
    """Answer a question with the tile that it asks for, of which there are four."""
    first = int(str(query.key_expr).rpartition("/")[2])
    message = message_class("RoadTiles")(version=1, more=first < 3)
    origin = {"vehicle": "other", "age_ms": 0}
    message.tiles.add(index=first, rows=TILE, origins=[origin])
    query.reply(query.key_expr, message.SerializeToString())


def test_only_the_tiles_that_changed_are_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet_map, "_EXCHANGE_SECONDS", 0.0)
    endpoint, asked = free_endpoint(), list[str]()

    def answer(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr).rpartition("/")[2])
        answer_with_a_tile(query)

    def exchanged() -> bool:
        fleet.exchange()
        return not fleet._asking and fleet._stale is None  # noqa: SLF001

    with zenoh.open(session_config([], 5.0, {"listen/endpoints": [endpoint]})) as session:
        queryable = session.declare_queryable("egp/**", answer)
        with FleetMap(endpoint, RoadBelief(PATH), road="ring", vehicle="car") as fleet:
            assert fleet.fetch()
            assert asked == ["0", "1", "2", "3"]
            asked.clear()
            for tiles in ([2], [1], [4000]):
                message = message_class("TilesChanged")(version=1, tiles=tiles)
                payload = zenoh.ZBytes(message.SerializeToString())
                sample: Any = SimpleNamespace(payload=payload)
                fleet._on_change(sample)  # noqa: SLF001
                if tiles == [1]:
                    fleet.exchange()
                    wait_until(exchanged)
                    assert asked == ["1", "2"]
            fleet.exchange()
            assert not fleet._asking  # noqa: SLF001
        queryable.undeclare()  # type: ignore[no-untyped-call]


def test_an_exchange_ages_one_tile(monkeypatch: pytest.MonkeyPatch) -> None:
    endpoint, now = free_endpoint(), 100.0
    clock = SimpleNamespace(monotonic=lambda: now, sleep=time.sleep)
    aged = list[int]()

    class Counting:
        """The belief, which notes the tiles that are reported."""

        def __init__(self, belief: RoadBelief) -> None:
            self._belief = belief

        def __getattr__(self, name: str) -> Any:  # noqa: ANN401
            return getattr(self._belief, name)

        def report(self, index: int, tile: bytes) -> None:
            aged.append(index)
            self._belief.report(index, tile)

    belief: Any = Counting(RoadBelief(PATH))
    with zenoh.open(session_config([], 5.0, {"listen/endpoints": [endpoint]})) as session:
        queryable = session.declare_queryable("egp/**", answer_with_a_tile)
        with FleetMap(endpoint, belief, road="ring", vehicle="car") as fleet:
            assert fleet.fetch()
            monkeypatch.setattr(fleet_map, "time", clock)
            for report in fleet._reports.values():  # noqa: SLF001
                report.aged = report.at = now
            for _ in range(2):
                aged.clear()
                now += 61.0
                for count in (1, 2, 3, 4, 4):
                    fleet.exchange()
                    assert len(aged) == count
                assert sorted(aged) == [0, 1, 2, 3]
            monkeypatch.undo()
        queryable.undeclare()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("of_evidence", [False, True])
def test_a_warning_says_what_the_service_does_not_accept(
    caplog: pytest.LogCaptureFixture,
    of_evidence: bool,  # noqa: FBT001 - a parameter
) -> None:
    endpoint = free_endpoint()
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")

    def answer(query: zenoh.Query) -> None:
        if ("/tile/" in str(query.key_expr)) == of_evidence:
            query.reply_err(bytes([0x08, 2]))
        else:
            query.reply(str(query.key_expr), b"")

    with zenoh.open(config) as session:
        queryable = session.declare_queryable("egp/**", answer)
        belief = RoadBelief(PATH)
        with FleetMap(endpoint, belief, road="ring", vehicle="car") as fleet:
            fleet.fetch()
            measure(belief, 0.4, 150.0)
        queryable.undeclare()  # type: ignore[no-untyped-call]
    told = " ".join(caplog.messages)
    assert ("does not accept evidence" in told) == of_evidence
    assert ("does not answer questions" in told) != of_evidence
