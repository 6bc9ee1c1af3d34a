"""The scene of a recording, road and car, as static archetypes of Rerun."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

if TYPE_CHECKING:
    from collections.abc import Iterable

    from google.protobuf.message import Message
    from numpy.typing import NDArray

_LABEL: Final = (255, 255, 255)
"""Colour of labels, which the viewer writes on a dark ground."""


def log_scene(recording: rr.RecordingStream, scene: Message, frames: dict[str, str]) -> None:
    """Log the entities of a `foxglove.SceneUpdate`; `frames` gives the path of each frame.

    Entities of other frames, whose place in the scene is not known, are left out.
    """
    for entity in scene.entities:
        if entity.frame_id not in frames:
            continue
        path = f"{frames[entity.frame_id]}/{entity.id}"
        for i, surface in enumerate(entity.triangles):
            mesh = rr.Mesh3D(
                vertex_positions=_points(surface.points),
                triangle_indices=np.reshape(surface.indices, (-1, 3)),
                vertex_colors=[_colour(colour) for colour in surface.colors],
            )
            recording.log(f"{path}/surface/{i}", mesh, static=True)
        for i, line in enumerate(entity.lines):
            strip = rr.LineStrips3D(
                [_points(line.points)],
                radii=rr.Radius.ui_points(0.5 * line.thickness),
                colors=[_colour(line.color)],
            )
            recording.log(f"{path}/line/{i}", strip, static=True)
        if entity.texts:
            labels = rr.Points3D(
                _points(text.pose.position for text in entity.texts),
                labels=[text.text for text in entity.texts],
                colors=_LABEL,
            )
            recording.log(f"{path}/label", labels, static=True)
        if entity.cubes:
            boxes = rr.Boxes3D(
                centers=_points(cube.pose.position for cube in entity.cubes),
                sizes=_points(cube.size for cube in entity.cubes),
                colors=[_colour(cube.color) for cube in entity.cubes],
                fill_mode="solid",
            )
            recording.log(f"{path}/body", boxes, static=True)


def _points(vectors: Iterable[Message]) -> NDArray[np.float32]:
    rows = [(vector.x, vector.y, vector.z) for vector in vectors]
    return np.array(rows, dtype=np.float32).reshape(-1, 3)


def _colour(colour: Message) -> tuple[float, float, float, float]:
    return (colour.r, colour.g, colour.b, colour.a)
