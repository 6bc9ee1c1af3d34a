"""Which replicas the monitor keeps if more of them are named than it has places for."""

from __future__ import annotations

from egp_service.control.messages import message_class
from egp_service.monitor.fleet import FORGET_SECONDS, Fleet


def states(fleet: Fleet, now: float) -> dict[str, str]:
    fleet.update(now)
    return {name: replica.state(now) for name, replica in fleet.replicas.items()}


def test_a_replica_with_a_token_takes_the_place_of_one_without() -> None:
    fleet, load = Fleet(), message_class("Load")(workers=2).SerializeToString()
    fleet.token("gone", 9.0, appeared=True)
    fleet.token("gone", 9.5, appeared=False)
    for number in range(1100):
        fleet.load(f"forged{number}", load, 10.0)
    for name in ("main", "other"):
        fleet.token(name, 11.0, appeared=True)
    assert len(fleet.replicas) == 1000
    found = states(fleet, 11.1)
    assert (found["main"], found["other"], found["gone"]) == ("serving", "serving", "gone")
    assert "forged2" in found
    # Neither a load without a token nor time takes their places.
    fleet.load("forged2000", load, 12.0)
    assert set(states(fleet, 12.0 + FORGET_SECONDS)) == {"main", "other"}


def test_a_token_is_remembered_until_there_is_a_place() -> None:
    fleet, load = Fleet(), message_class("Load")(workers=2).SerializeToString()
    for number in range(1000):
        fleet.token(f"r{number}", 10.0, appeared=True)
    fleet.token("late", 10.1, appeared=True)
    fleet.load("late", load, 10.2)
    assert "late" not in fleet.replicas
    fleet.token("r7", 11.0, appeared=False)
    fleet.load("late", load, 11.5)
    assert "late" in fleet.replicas
    assert "r7" not in fleet.replicas
    assert states(fleet, 12.0 + FORGET_SECONDS)["late"] == "silent", "its token is still there"


def test_the_number_of_tokens_is_bounded() -> None:
    fleet = Fleet()
    for number in range(10_100):
        fleet.token(f"r{number}", 10.0, appeared=True)
    assert len(fleet._tokens) == 10_000  # noqa: SLF001
    for number in range(10_100):
        fleet.token(f"r{number}", 11.0, appeared=False)
    assert not fleet._tokens  # noqa: SLF001
