"""What a terminal shows during a run and during training."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest
from rich.console import Console

from egp_service.cli.progress import fitting
from egp_service.cli.status_line import status_text
from egp_service.simulation.trace import Period, Truth
from egp_service.training.train import FitProgress

if TYPE_CHECKING:
    from egp_service.control.step import Step

TRUTH = Truth(
    time=987.6,
    x=np.array([0.0, 0.0, 45.67, 0.0, 0.0, 0.0, 0.0]),
    friction=0.5,
    distance=9876.5,
    path_s=0.0,
    lateral_error=-1.23,
    heading_error=0.0,
    speed_reference=45.0,
    friction_planned=0.5,
)


def shown(columns: int, label: str, mode: str = "normal", members: int = 7) -> str:
    weights = np.linspace(1.0, 0.2, members)
    step = SimpleNamespace(mode=mode, weights=weights, timings=SimpleNamespace(total=0.123))
    period = Period(TRUTH, TRUTH.x, cast("Step", step))
    line = status_text(label, period, columns)
    assert line.cell_len <= columns
    return line.plain


def test_80_columns_show_everything_but_a_long_name() -> None:
    line = shown(80, "rounded-rectangle")
    assert line == (
        "normal  987.6 s  9876 m  45.7 m/s  lateral -1.23 m  μ 0.50  █▇▆▅▄▃▂  step 123 ms"
    )
    assert "rounded-rectangle" in shown(100, "rounded-rectangle")
    # The demo tells its laps apart.
    assert "second lap" in shown(80, "second lap", members=2)


@pytest.mark.parametrize("columns", range(10, 80))
def test_a_narrower_terminal_shows_fewer_things_and_none_in_part(columns: int) -> None:
    everything = shown(200, "a name", "waiting").split("  ")
    parts = shown(columns, "a name", "waiting").split("  ")
    assert parts[0] == "waiting"
    assert set(parts) <= set(everything)


@pytest.mark.parametrize("terminal", [False, True])
def test_training_has_a_bar_from_its_first_fit_on(terminal: bool) -> None:  # noqa: FBT001
    shown = io.StringIO()
    with fitting(Console(file=shown, force_terminal=terminal)) as report:
        assert "loss" not in shown.getvalue()
        report(FitProgress("wet", 1.25, 1, 2))
    assert ("Preparing the data ..." in shown.getvalue()) == terminal
    assert shown.getvalue().count("trained") == 1


def test_an_error_before_the_first_fit_leaves_no_bar() -> None:
    shown = io.StringIO()
    with pytest.raises(ValueError, match="data"), fitting(Console(file=shown)):
        raise ValueError("data")
    assert not shown.getvalue()
