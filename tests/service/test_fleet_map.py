"""The vehicle's side of the fleet's map, with a service that answers what a test wants."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
import zenoh

from egp_service._core import EgpError, RoadBelief
from egp_service.control.endpoints import free_endpoint
from egp_service.control.fleet_map import FleetMap
from egp_service.control.session import session_config
from patience import wait_until
from road_evidence import PATH, measure, measured
from road_messages import no_tiles

TILE = measured(0.5).tile(0)


def test_a_lost_answer_is_asked_for_again_while_the_vehicle_waits() -> None:
    endpoint = free_endpoint()
    lost: list[zenoh.Query] = []
    answered = 0

    def answer(query: zenoh.Query) -> None:
        nonlocal answered
        if lost:
            query.reply(query.key_expr, no_tiles())
            answered += 1
        else:
            lost.append(query)  # a query that is kept has no end

    with zenoh.open(session_config([], 5.0, {"listen/endpoints": [endpoint]})) as session:
        queryable = session.declare_queryable("egp/**", answer)
        # It connects to every endpoint; nobody listens at the first one.
        belief, endpoints = RoadBelief(PATH), [free_endpoint(), endpoint]
        with FleetMap(endpoints, belief, road="r", vehicle="v", timeout=6.0) as fleet:
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
            query.reply(key, no_tiles())

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
            query.reply(str(query.key_expr), no_tiles())

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


def test_a_closed_map_is_an_error() -> None:
    fleet = FleetMap(free_endpoint(), RoadBelief(PATH), road="r", vehicle="v", timeout=0.1)
    fleet.close()
    fleet.close()
    assert fleet.origins == {}
    for use in (fleet.fetch, fleet.exchange, fleet.__enter__):
        with pytest.raises(EgpError, match="map was closed: make another"):
            use()


def test_no_query_waits_for_a_full_link(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[dict[str, object]]()
    with FleetMap(free_endpoint(), RoadBelief(PATH), road="r", vehicle="v", timeout=0.1) as fleet:
        session = SimpleNamespace(
            get=lambda _key, _handler, **options: asked.append(options),
            close=fleet._session.close,  # noqa: SLF001
        )
        monkeypatch.setattr(fleet, "_session", session)
        assert not fleet.fetch()
        (options,) = asked
        assert options["congestion_control"] == zenoh.CongestionControl.DROP


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
            query.reply(str(query.key_expr), no_tiles())

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
