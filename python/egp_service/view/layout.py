"""Which views the viewer of Rerun shows at once, and where."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun.blueprint as rrb

from egp_service.control.recorder import MAP
from egp_service.view.entities import CAR, TIMELINE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from egp_service.view.run import RecordedRun

_LIGHT: Final = (0xF4, 0xF5, 0xF7)
_ASPECT: Final = 1.4
"""Width of the map's view over its height."""
_MARGIN: Final = 1.1
_AROUND: Final = 40.0
"""Height of the ground in the view that follows the car, and the least one of the map, m."""
_AHEAD: Final = 8.0
"""Distance of that view's centre from the car, m."""


def layout(run: RecordedRun) -> rrb.Blueprint:
    """Return the layout: the maps over the states on the left, the curves on the right."""
    known = [_curves("lateral", "Beside the path, m")] if run.truths else []
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _map(run),
                _from_above("Car", CAR, (_AHEAD, 0.0), _AROUND, up=(1.0, 0.0, 0.0)),
                rrb.StateTimelineView(origin="state", name="Mode and status"),
                row_shares=[3, 2, 1],
            ),
            rrb.Vertical(
                *known,
                _curves("speed", "Speed, m/s"),
                _curves("force", "Force, N"),
                _curves("steering", "Steering: angle, rad, and rate, rad/s"),
            ),
            rrb.Vertical(
                _curves("friction", "Friction", (0.0, 1.4)),
                _curves("weights", "Weights of the members", (0.0, 1.0)),
                _curves("times", "Times of a step, ms"),
                rrb.TextLogView(
                    origin="changes",
                    name="Changes of mode and status",
                    columns=rrb.TextLogColumns(text_log_columns=["Body"]),
                ),
            ),
            column_shares=[4, 3, 3],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _map(run: RecordedRun) -> rrb.Spatial3DView:
    """Look down on everything that was driven."""
    places = np.array(list(run.poses.values()) or [(0.0, 0.0, 0.0)])[:, :2]
    low, high = places.min(axis=0), places.max(axis=0)
    width, height = np.maximum(high - low, _AROUND).tolist()
    centre = (0.5 * (low + high)).tolist()
    return _from_above(
        "Map", MAP, centre, _MARGIN * max(height, width / _ASPECT), up=(0.0, 1.0, 0.0)
    )


def _from_above(
    name: str, origin: str, centre: Sequence[float], height: float, up: tuple[float, float, float]
) -> rrb.Spatial3DView:
    """Return a view of the ground from above `centre`, m, which shows about `height` m of it."""
    x, y = centre
    eye = rrb.EyeControls3D(position=(x, y, height), look_target=(x, y, 0.0), eye_up=up)
    return rrb.Spatial3DView(
        origin=origin,
        contents=f"/{MAP}/**",
        name=name,
        background=_LIGHT,
        line_grid=False,
        eye_controls=eye,
    )


def _curves(
    origin: str, name: str, bounds: tuple[float, float] | None = None
) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=origin,
        name=name,
        axis_y=None if bounds is None else rrb.ScalarAxis(range=bounds),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
    )
