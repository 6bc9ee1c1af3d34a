"""The picture of `egp load --replay`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from matplotlib.figure import Figure

from egp_service.simulation.load_figure import draw_load

if TYPE_CHECKING:
    from pathlib import Path


def rate(vehicles: int, share: float, *quantiles: float | None) -> dict[str, object]:
    return {
        "vehicles": vehicles,
        "requests_per_second": 50.0 * vehicles,
        "in_deadline_fraction": share,
        "least_vehicle_fraction": share,
        "latency_ms": dict(zip(("p50", "p99", "p999", "max"), quantiles, strict=True)),
        "generator_lag_ms": {"p99": 0.5},
    }


def test_a_triangle_is_above_rates_whose_quantiles_fall_on_requests_without_a_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Figure] = []

    def keep(figure: Figure, path: Path) -> None:
        drawn.append(figure)
        path.touch()

    monkeypatch.setattr(Figure, "savefig", keep)
    report = {
        "hold": 0.99,
        "knee_vehicles": 32,
        "period_s": 0.02,
        "rates": [rate(32, 1.0, 0.7, 2.0, 4.0, None), rate(64, 0.7, 9.0, None, None, None)],
    }
    (tmp_path / "knee.json").write_text(json.dumps(report))
    draw_load(tmp_path / "knee.json", tmp_path / "knee.png")
    (triangle,) = (line for line in drawn[0].axes[1].get_lines() if line.get_marker() == "^")
    assert triangle.get_label() == "others: no reply, or refused"
    assert triangle.get_xdata() == pytest.approx([3200.0])
