"""Figures whose texts do not overlap, and axes that can be read."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.text import Text

from egp_service import Path
from egp_service.evaluation import figures
from egp_service.evaluation.statistics import Interval
from egp_service.simulation.report import (
    STYLE,
    _commands_figure,
    _comparison_figure,
    draw_track,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MU = (1.1, 0.6, 0.9, 0.5, 1.0, 0.75)


def run(path: Path, friction: tuple[float, ...] = (1.0,), reason: str = "") -> Any:  # noqa: ANN401 - in place of a Run
    """Drive along the path at 10 m/s; `reason` is why the run was not completed."""
    s = np.arange(0.0, path.length, 2.0)
    x, y, yaw = path.sample(s)[:3]
    still = np.zeros(len(s))
    return SimpleNamespace(
        path=path,
        dt=0.2,
        trace=SimpleNamespace(
            x=np.column_stack([x, y, still + 10.0, yaw, still, still, still]),
            u=np.zeros((len(s), 2)),
            distance=s,
            friction=np.resize(friction, len(s)),
            lateral_error=still,
        ),
        summary=SimpleNamespace(
            ending=SimpleNamespace(completed=not reason, reason=reason, position=(0.0, 0.0)),
            lateral_error=SimpleNamespace(max=0.12),
        ),
    )


def overlaps(figure: Figure, texts: list[Text]) -> list[tuple[str, str]]:
    """Pairs of texts that overlap, or nearly do so."""
    figure.canvas.draw()
    boxes = [(text.get_text().strip(), text.get_window_extent().padded(2.0)) for text in texts]
    return [
        (name, other)
        for i, (name, box) in enumerate(boxes)
        for other, its in boxes[:i]
        if box.overlaps(its)
    ]


def test_the_scale_is_beside_the_labels_of_the_friction() -> None:
    zones = [(i / len(MU), mu) for i, mu in enumerate(MU)]
    path = Path.random(8, length=1200.0).with_friction(zones)
    with plt.style.context(STYLE):
        figure, axes = plt.subplots(1, 3, figsize=(12.5, 3.0))
        for ax in axes:
            draw_track(ax, run(path))
        texts = [text for text in axes[0].texts if text.get_text()]
        assert len(texts) == len(MU) + 1
        scale = texts[-1].get_text().strip()
        assert scale.endswith(" m")
        assert not [pair for pair in overlaps(figure, texts) if scale in pair]
        plt.close(figure)


def test_titles_of_runs_side_by_side_are_apart() -> None:
    path = Path.rounded_rectangle()
    lost = run(path, reason="more than 3 m beside the path after 274 m: +3.02 m")
    with plt.style.context(STYLE):
        figure = _comparison_figure([("told, mu 0.5", lost), *[("told, mu 1.1", run(path))] * 4])
        titles = [text for text in figure.findobj(Text) if text.get_text().startswith("told, mu ")]
        titles = [text for text in titles if "beside" in text.get_text()]
        assert len(titles) == 5
        assert not overlaps(figure, titles)
        plt.close(figure)


def test_the_ticks_of_accelerations_are_apart() -> None:
    with plt.style.context(STYLE):
        figure = _commands_figure(run(Path.rounded_rectangle(), (0.45, 0.7, 1.0)))
        (diagram,) = (ax for ax in figure.axes if ax.get_title(loc="left") == "Accelerations")
        assert not overlaps(figure, diagram.get_xticklabels())
        plt.close(figure)


@pytest.mark.parametrize("decades", [0.8, 2.5])
def test_the_axis_of_errors_says_that_it_is_logarithmic(
    decades: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    save = Mock()
    monkeypatch.setattr(figures, "save", save)
    groups = [
        Mock(
            contender=str(error),
            condition="one",
            share=Interval(1.0, 0.5, 1.0),
            lateral_rms=Interval(error, error, error),
        )
        for error in (0.12, 0.12 * 10.0**decades)
    ]
    figures.draw_completion(groups, Mock())
    figure = save.call_args.args[0]
    axis = figure.axes[1]
    assert axis.get_xlabel() == "logarithmic"
    low, high = axis.get_xlim()
    labels = axis.get_xticklabels()
    assert sum(low <= label.get_position()[0] <= high for label in labels) >= 4
    assert not overlaps(figure, labels)
    plt.close(figure)
