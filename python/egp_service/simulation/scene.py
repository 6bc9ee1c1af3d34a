"""The road and the car as a Foxglove scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from egp_service._core import VehicleParameters
from egp_service.control.messages import message_class
from egp_service.control.recorder import MAP, VEHICLE, timestamp
from egp_service.simulation.course import build_path
from egp_service.simulation.scenario import vehicle_parameters

if TYPE_CHECKING:
    from google.protobuf.message import Message
    from numpy.typing import NDArray

    from egp_service._core import Path
    from egp_service.simulation.scenario import Scenario

# Lengths in m, of full-size vehicles: those of smaller ones are in proportion to their scale.
_SPACING: Final = 1.0
_FREE: Final = 2.0
"""Width drawn on each side of a path without edges."""
# Colours of friction from ice to dry asphalt.
_FRICTION: Final = np.array([0.1, 0.5, 1.2])
_COLOURS: Final = np.array([[0.81, 0.90, 0.96], [0.42, 0.61, 0.75], [0.36, 0.37, 0.40]])
_OVERHANG, _HEIGHT = 1.7, 1.4
"""Length of the car's body beyond its axles, both ends together, and its height."""


def road_scene(scenario: Scenario) -> SceneUpdate:
    """Return the road, coloured by friction, its edges, the path, and the vehicle.

    The vehicle is drawn in the frame `vehicle`, the road in the frame `map`.
    """
    car = vehicle_parameters(scenario)
    centre, lefts, rights, friction = _outline(build_path(scenario), car.scale)
    if scenario.plant is None:
        car = VehicleParameters.commonroad(scenario.vehicle)
    ink = Color(r=0.12, g=0.16, b=0.22, a=1.0)
    white = Color(r=1.0, g=1.0, b=1.0, a=0.9)
    road = SceneEntity(
        timestamp=timestamp(0.0),
        frame_id=MAP,
        id="road",
        triangles=[_surface(lefts, rights, friction)],
        lines=[_line(lefts, 2.0, ink), _line(rights, 2.0, ink), _line(centre, 1.0, white)],
        texts=_labels(centre, friction, ink),
    )
    return SceneUpdate(entities=[road, _car(car)])


def vehicle_road(scenario: Scenario) -> Message:
    """Return the road as the message `VehicleRoad`, which displays draw."""
    scale = vehicle_parameters(scenario).scale
    _, lefts, rights, friction = _outline(build_path(scenario), scale)
    return message_class("VehicleRoad")(
        version=1,
        left_x=lefts[:, 0],
        left_y=lefts[:, 1],
        right_x=rights[:, 0],
        right_y=rights[:, 1],
        friction=friction,
    )


def _outline(path: Path, scale: float) -> tuple[NDArray[np.float64], ...]:
    """Give centre, left and right edge (n, 2) and friction (n,) of a path."""
    s = np.linspace(0.0, path.length, max(2, 1 + round(path.length / (scale * _SPACING))))
    x, y, yaw, _, left, right, friction = path.sample(s)
    centre, normal = np.column_stack([x, y]), np.column_stack([-np.sin(yaw), np.cos(yaw)])
    lefts = centre + normal * np.where(np.isfinite(left), left, scale * _FREE)[:, None]
    rights = centre - normal * np.where(np.isfinite(right), right, scale * _FREE)[:, None]
    return centre, lefts, rights, friction


def _car(car: VehicleParameters) -> SceneEntity:
    ahead, height = 0.5 * (car.l_f - car.l_r), car.scale * _HEIGHT
    size = Vector3(x=car.l_f + car.l_r + car.scale * _OVERHANG, y=car.width, z=height)
    body = CubePrimitive(
        pose=Pose(position=Vector3(x=ahead, z=0.5 * height), orientation=Quaternion(w=1.0)),
        size=size,
        color=Color(r=0.76, g=0.25, b=0.05, a=0.9),
    )
    return SceneEntity(
        timestamp=timestamp(0.0), frame_id=VEHICLE, frame_locked=True, id="car", cubes=[body]
    )


def _line(points: NDArray[np.float64], pixels: float, colour: Color) -> LinePrimitive:
    return LinePrimitive(
        type=LinePrimitive.LINE_STRIP,
        pose=Pose(orientation=Quaternion(w=1.0)),
        thickness=pixels,
        scale_invariant=True,
        points=[Point3(x=p_x, y=p_y, z=0.02) for p_x, p_y in points],
        color=colour,
    )


def _surface(
    lefts: NDArray[np.float64], rights: NDArray[np.float64], friction: NDArray[np.float64]
) -> TriangleListPrimitive:
    corners = [Point3(x=p_x, y=p_y) for p_x, p_y in np.concatenate([lefts, rights])]
    n = len(lefts)
    first = np.arange(n - 1)
    upper = np.column_stack([first, first + 1, first + n])
    lower = np.column_stack([first + 1, first + n + 1, first + n])
    red, green, blue = (np.interp(friction, _FRICTION, channel) for channel in _COLOURS.T)
    colours = [Color(r=r, g=g, b=b, a=1.0) for r, g, b in zip(red, green, blue, strict=True)]
    return TriangleListPrimitive(
        pose=Pose(orientation=Quaternion(w=1.0)),
        points=corners,
        colors=colours * 2,
        indices=np.column_stack([upper, lower]).ravel().tolist(),
    )


def _labels(
    centre: NDArray[np.float64], friction: NDArray[np.float64], colour: Color
) -> list[TextPrimitive]:
    """Name the friction at the beginning of each zone."""
    # The last row of a closed path is its first one.
    places = [0, *(np.flatnonzero(np.diff(friction[:-1])) + 1).tolist()]
    return [
        TextPrimitive(
            pose=Pose(
                position=Vector3(x=centre[i, 0], y=centre[i, 1], z=2.0),
                orientation=Quaternion(w=1.0),
            ),
            billboard=True,
            font_size=14.0,
            scale_invariant=True,
            color=colour,
            text=f"friction {friction[i]:g}",
        )
        for i in places
    ]
