"""What tests of vehicles behind topics share."""

from __future__ import annotations

import importlib

import pytest


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> object:
    """Replace the time of the adapter, and the thread in which it reads paths."""
    # Tests are skipped where the libraries of the extra are missing, but this file is loaded.
    driving = importlib.import_module("egp_service.ros2.driving")
    topics = importlib.import_module("ros2.topics")
    replaced = topics.Clock()
    monkeypatch.setattr(driving, "time", replaced)
    monkeypatch.setattr(driving, "ThreadPoolExecutor", topics.Reader)
    return replaced
