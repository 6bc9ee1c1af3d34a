"""Sessions of zenoh that the package opens."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from egp_service import FleetMap, StatusPublisher
from egp_service.control.network import Network
from egp_service.control.router import Router
from egp_service.monitor.listener import Listener
from egp_service.ros2.node import Node


class Stuck:
    """A session with a link that does not close in time."""

    closed = 0

    def close(self) -> None:
        """Raise the error of zenoh."""
        self.closed += 1
        raise zenoh.ZError("close operation timed out")


@pytest.mark.parametrize("kind", [FleetMap, Listener, Network, Node, Router, StatusPublisher])
def test_a_link_that_does_not_close_in_time_replaces_no_result(kind: type[Any]) -> None:
    opened, stuck = object.__new__(kind), Stuck()
    exchange = SimpleNamespace(finish=lambda _: None, next_action=lambda: None, next_wake=None)
    vars(opened).update(
        {"_session": stuck, "session": stuck, "_closed": False, "_exchange": exchange},
        _last=None,
    )
    opened.close()
    assert stuck.closed == 1
