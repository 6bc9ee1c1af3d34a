"""Paths, the vehicle's projection on them, speed profiles, and the reference of a step."""

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from typing import TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from egp_service._core.vehicle import VehicleParameters

# A surface: a friction coefficient, the name of a preset, or a table of factors.
_Surface: TypeAlias = float | str | Mapping[str, float]

@final
class Path:
    """A curve by arc length `s` in m, with distances to the track's edges and zones of friction.

    Closed paths wrap at their length; open ones continue straight beyond their ends. All quantities
    are in SI units. Yaw is counter-clockwise from +x, and lateral errors are positive to the left.
    A path does not change; pickle hands the same path, bit for bit, over to another process.
    """

    @staticmethod
    def from_points(points: ArrayLike, closed: bool, widths: ArrayLike | None = None) -> Path:
        """Make a smooth path through points (n, 2), m, n >= 4.

        `widths` (n, 2) are the distances `[left, right]`, m, to the edges at the points.

        Raises:
            InvalidArgumentError: for fewer than 4 points, repeated ones, turns that are too sharp,
                a path that is too long, coordinates that are not finite or beyond 1e8 m, and widths
                that are not finite, negative, or of another number.

        """
    @staticmethod
    def rounded_rectangle(
        length: float = 120.0,
        width: float = 60.0,
        radius: float = 15.0,
        transition: float = 10.0,
        track_width: float = 7.0,
    ) -> Path:
        """Make a counter-clockwise lap that starts along +x in the middle of the lower side.

        Corners are arcs between clothoids of length `transition`. All dimensions are in m.

        Raises:
            InvalidArgumentError: if a dimension is out of range or a side is too short for its
                corners.

        """
    @staticmethod
    def l_shape(
        length: float = 130.0,
        width: float = 110.0,
        arm: float = 50.0,
        radius: float = 15.0,
        transition: float = 10.0,
        track_width: float = 7.0,
    ) -> Path:
        """Make a closed L with arms of width `arm`: five left turns and a right one.

        All dimensions are in m.

        Raises:
            InvalidArgumentError: as for `rounded_rectangle`.

        """
    @staticmethod
    def iso_3888_2(
        vehicle_width: float,
        margin: float = 0.1,
        lead_in: float = 40.0,
        lead_out: float = 40.0,
    ) -> Path:
        """Make the severe double lane change of ISO 3888-2, with a drivable path between the cones.

        Widths reach to the cones, which start after `lead_in`; `margin` is the distance between the
        cones and the sides of a vehicle on the path. All dimensions are in m.

        Raises:
            InvalidArgumentError: if a dimension is out of range or the margin leaves no room in the
                first lane.

        """
    @staticmethod
    def lane_changes(
        length: float = 500.0,
        offset: float = 2.5,
        transition: float = 30.0,
        hold: float = 20.0,
        track_width: float = 7.0,
    ) -> Path:
        """Make a straight road on which the path repeatedly changes to the left lane and back.

        All dimensions are in m.

        Raises:
            InvalidArgumentError: if a dimension is out of range or the road is too short for a lane
                change and back.

        """
    @staticmethod
    def random(
        seed: int, length: float = 500.0, min_radius: float = 15.0, track_width: float = 7.0
    ) -> Path:
        """Make a closed track from a seed: no crossing, no turn tighter than `min_radius`.

        All dimensions are in m.

        Raises:
            InvalidArgumentError: if a dimension is out of range, the lap is too short for the
                radius, or the radius is at most half the track's width.

        """
    @staticmethod
    def from_csv(file: str | PathLike[str], scale: float = 1.0, closed: bool = True) -> Path:
        """Read a track: a raceline, or a centre line with distances to both edges.

        Columns are separated by commas or semicolons; a first line with names may reorder them.
        `s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2` has no widths, and its psi must fit
        the positions, measured from +x or from +y; `x_m,y_m,w_tr_right_m,w_tr_left_m` has widths.
        Lengths are in m and multiplied by `scale`, which is 10 for a track of 1:10 cars. The end of
        a `closed` track leads to its start; the last line may repeat the first. One that is not
        closed ends at the last line.

        Raises:
            InvalidArgumentError: unless `scale` is positive.
            EgpError: if the file cannot be read, is larger than 16 MiB or has another format, if
                the end of a closed track is far from its start, or if `from_points` does not accept
                its points.

        """
    def with_friction(
        self,
        zones: Iterable[tuple[float, _Surface] | tuple[float, _Surface, _Surface]]
        | Iterable[Sequence[_Surface]]
        | NDArray[np.floating],
    ) -> Path:
        """Return the same path with zones of other surfaces.

        A zone is its start as a fraction of the length, and its surface, which `surface_friction`
        describes; the first starts at 0. A third member is the surface to the right of the path,
        and the second is then that to the left. Zones may be rows of an array.

        Raises:
            InvalidArgumentError: for zones of another form, if the starts do not increase from 0 to
                below 1, and if a surface is unknown or out of range.

        """
    def __copy__(self) -> Path: ...
    def __deepcopy__(self, memo: object, /) -> Path: ...
    @property
    def length(self) -> float:
        """Length in m, of one lap if closed."""
    @property
    def closed(self) -> bool:
        """Whether the end joins the start."""
    def project(self, position: ArrayLike, hint: float | None = None) -> Projection:
        """Return the point of the path that is nearest to a position `[x, y]` (2,), m.

        With the last `s`, m, as `hint`, the search starts there and goes downhill, so that it stays
        on its branch where the path comes close to itself. Without a hint the whole path is
        searched.

        Raises:
            InvalidArgumentError: if a number is not finite.

        """
    def sample(
        self, s: ArrayLike
    ) -> tuple[
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
    ]:
        """Return x, y, yaw, curvature, left, right, friction at arc lengths `s` (n,), each (n,).

        Lengths are in m, the curvature in 1/m. Yaw lies in [-pi, pi]; left and right are infinite
        on a path without widths.

        Raises:
            InvalidArgumentError: for an arc length that is not finite.

        """

@final
class Projection:
    """A position relative to a path, and the path at its nearest point."""

    @property
    def s(self) -> float:
        """Arc length of the nearest point, m; beyond an open path's ends that of its extension."""
    @property
    def lateral(self) -> float:
        """Signed distance from the path, m, positive to its left."""
    @property
    def x(self) -> float:
        """The nearest point's x, m."""
    @property
    def y(self) -> float:
        """The nearest point's y, m."""
    @property
    def yaw(self) -> float:
        """The path's direction, rad, in [-pi, pi]."""
    @property
    def curvature(self) -> float:
        """Curvature in 1/m, positive in left turns."""
    @property
    def left(self) -> float:
        """Distance from the path to the left edge, m; infinite without widths."""
    @property
    def right(self) -> float:
        """Distance from the path to the right edge, m; infinite without widths."""
    @property
    def friction(self) -> float:
        """Friction coefficient."""

@final
class SpeedProfile:
    """The fastest speed along a path within `grip` (a fraction) of the friction ellipse.

    `vehicle` states the reachable shares of the friction, the strongest braking and the strongest
    drive. `v_max` and the start and end speed of an open path are in m/s; the latter default to the
    fastest. `tyres` has rows of a friction coefficient and the `lateral_grip` of its member (n, 2),
    with increasing friction: in bends the profile then asks for at most 95 % of what the tyres
    transmit, `min(grip * vehicle.lateral_grip, 0.95 * lateral_grip(mu)) * mu * g`. Between rows
    `mu * lateral_grip` is interpolated linearly, and continued below them.

    Raises:
        InvalidArgumentError: if a number is out of range, the frictions do not increase, or a
            closed path has a start or an end speed.

    """

    def __new__(
        cls,
        path: Path,
        vehicle: VehicleParameters,
        grip: float = 0.8,
        v_max: float = 30.0,
        *,
        start_speed: float | None = None,
        end_speed: float | None = None,
        tyres: ArrayLike | None = None,
    ) -> SpeedProfile: ...
    @staticmethod
    def constant(path: Path, speed: float) -> SpeedProfile:
        """Make a profile with one speed in m/s everywhere.

        Raises:
            InvalidArgumentError: unless the speed is from 0.001 to 10000 m/s.

        """
    @property
    def lap_time(self) -> float:
        """Seconds for the lap, or from start to end."""
    def speed(self, s: ArrayLike) -> NDArray[np.float64]:
        """Return the speed in m/s at arc lengths (n,) in m, of any lap of a closed path.

        Raises:
            InvalidArgumentError: for an arc length that is not finite.

        """

def horizon_reference(
    path: Path,
    profile: SpeedProfile,
    x: ArrayLike,
    dt: float,
    horizon: int,
    hint: float | None = None,
    *,
    catch_up: bool = True,
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, Projection]:
    """Return reference rows `[p_x, p_y, v_x, psi]` (horizon + 1, 4), widths and projection.

    `x` is the vehicle's state (7,), and `dt` the control period in s. Rows, in m, m, m/s and rad,
    follow the profile by time from the vehicle's projection; yaw is unwrapped relative to the
    vehicle's. Widths `[left, right]` (horizon + 1, 2), m, are None for a path without. Pass the
    last projection's `s`, m, as `hint`.

    If the profile is more than 2 m/s above the vehicle's `v_x`, as at a start, the rows catch up
    with it: after `t` seconds their speed is at most `v_x + 2 m/s + 1 m/s² t`. Without `catch_up`
    they follow the profile however far the vehicle is behind.

    Raises:
        InvalidArgumentError: if position, yaw or hint is not finite, `dt` is not positive, or the
            profile is not one of `path`, which may have other widths and zones of friction.

    """
