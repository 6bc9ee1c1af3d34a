"""Paths, speed profiles and horizon references from Python, against scipy and plain integration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from egp_service._core import (
    EgpError,
    InvalidArgumentError,
    Path,
    SpeedProfile,
    VehicleParameters,
    horizon_reference,
)

if TYPE_CHECKING:
    from pathlib import Path as FilePath


CAR = VehicleParameters.commonroad(1)
Zones: TypeAlias = Any  # also what is no zones


def state(x: float, y: float, psi: float) -> np.ndarray:
    return np.array([x, y, 10.0, psi, 0.0, 0.0, 0.0])


def test_a_closed_path_is_scipys_periodic_spline() -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 41)
    points = np.column_stack([50.0 * np.cos(t) + 6.0 * np.cos(3.0 * t), 30.0 * np.sin(t)])
    points[-1] = points[0]
    path = Path.from_points(points, closed=True)
    chords = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    oracle = CubicSpline(chords, points, bc_type="periodic")

    fine = np.linspace(0.0, chords[-1], 200_001)
    speed = np.hypot(*oracle(fine, 1).T)
    travelled = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2.0 * np.diff(fine))])
    assert path.length == pytest.approx(travelled[-1], rel=1e-7)

    s = np.linspace(0.0, path.length, 300, endpoint=False)
    u = np.interp(s, travelled, fine)
    x, y, yaw, curvature, *_ = path.sample(s)
    first, second = oracle(u, 1), oracle(u, 2)
    np.testing.assert_allclose(np.column_stack([x, y]), oracle(u), atol=1e-4)
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    np.testing.assert_allclose(curvature, cross / np.hypot(*first.T) ** 3, atol=1e-3)
    turn = yaw - np.arctan2(first[:, 1], first[:, 0])
    np.testing.assert_allclose(np.sin(turn), 0.0, atol=1e-4)


def test_projection_gives_back_where_one_stands() -> None:
    path = Path.rounded_rectangle()
    s = np.linspace(0.0, path.length, 50, endpoint=False)
    x, y, yaw, *_ = path.sample(s)
    for i in range(s.size):
        position = np.array([x[i] + 1.5 * np.sin(yaw[i]), y[i] - 1.5 * np.cos(yaw[i])])
        for hint in (None, s[i] + 2.0):
            found = path.project(position, hint)
            assert found.s == pytest.approx(s[i], abs=1e-5)
            assert found.lateral == pytest.approx(-1.5, abs=1e-6)
            assert (found.left, found.right) == pytest.approx((3.5, 3.5))


def test_tracks_have_the_size_they_are_asked_for() -> None:
    for path, length, width in (
        (Path.rounded_rectangle(length=100.0, width=70.0), 100.0, 70.0),
        (Path.l_shape(length=140.0, width=120.0, arm=50.0), 140.0, 120.0),
    ):
        x, y, yaw, curvature, *_ = path.sample(np.linspace(0.0, path.length, 4000))
        assert np.ptp(x) == pytest.approx(length, abs=1e-3)
        assert np.ptp(y) == pytest.approx(width, abs=1e-3)
        assert np.abs(curvature).max() == pytest.approx(1.0 / 15.0, rel=0.01)
        assert (x[0], y[0], yaw[0]) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_the_double_lane_change_keeps_its_distance_from_the_cones() -> None:
    path = Path.iso_3888_2(vehicle_width=1.8, margin=0.15, lead_in=30.0, lead_out=20.0)
    x, _, _, curvature, left, right, _ = path.sample(np.linspace(0.0, path.length, 2000))
    assert x[-1] == pytest.approx(30.0 + 61.0 + 20.0)
    assert min(left.min(), right.min()) > 0.9 + 0.15 - 5e-3
    middle = np.abs(x - 30.0 - 31.0) < 4.0
    np.testing.assert_allclose((left + right)[middle], 1.8 + 1.0, atol=1e-6)
    assert 15.0**2 * np.abs(curvature).max() < 11.0


def test_lane_changes_and_random_tracks() -> None:
    changes = Path.lane_changes(length=300.0, offset=3.0)
    y = changes.sample(np.linspace(0.0, changes.length, 1000))[1]
    assert (y.min(), y.max()) == pytest.approx((0.0, 3.0), abs=1e-3)
    track = Path.random(seed=3, length=400.0, min_radius=12.0)
    assert track.closed
    assert track.length == pytest.approx(400.0, rel=1e-3)
    assert Path.random(seed=3).length == Path.random(seed=3).length


def test_track_files_are_read_and_refusals_name_file_and_line(tmp_path: FilePath) -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 50, endpoint=False)
    table = np.column_stack([30.0 * np.cos(t), 20.0 * np.sin(t), 0.0 * t + 3.0, 0.0 * t + 4.0])
    file = tmp_path / "centre.csv"
    np.savetxt(file, table, delimiter=",", header="x_m,y_m,w_tr_right_m,w_tr_left_m")
    path = Path.from_csv(file)
    expected = Path.from_points(table[:, :2], closed=True, widths=table[:, [3, 2]])
    s = np.linspace(0.0, path.length, 40)
    np.testing.assert_array_equal(path.sample(s), expected.sample(s))
    file.write_text("# x\n1,2,3,4\n1,2,oops,4\n")
    with pytest.raises(EgpError, match=r"centre\.csv: line 3: .* w_tr_right_m, got \"oops\""):
        Path.from_csv(file)
    with pytest.raises(EgpError, match=r"none\.csv"):
        Path.from_csv(str(tmp_path / "none.csv"))


def test_zones_slow_the_profile_down() -> None:
    path = Path.rounded_rectangle().with_friction([(0.0, 0.5), (0.5, 1.1)])
    s = np.array([0.25, 0.75]) * path.length
    assert path.sample(s)[6].tolist() == [0.5, 1.1]
    profile = SpeedProfile(path, CAR, grip=0.9)
    slow, fast = profile.speed(np.linspace(0.0, path.length, 1000)).reshape(2, 500).min(axis=1)
    # The lateral limit at the same curvature: v² grows with the friction.
    assert fast / slow == pytest.approx(np.sqrt(1.1 / 0.5), rel=0.02)
    assert profile.lap_time < SpeedProfile(path, CAR, grip=0.6).lap_time


def test_the_reference_moves_by_time_from_the_projection() -> None:
    path = Path.rounded_rectangle()
    profile = SpeedProfile(path, CAR)
    s = 40.0
    for stage in range(0, 21, 5):
        steps = 2000
        travelled = s
        for _ in range(steps * (stage > 0)):
            middle = (
                travelled + 0.5 * stage * 0.05 / steps * profile.speed(np.array([travelled]))[0]
            )
            travelled += stage * 0.05 / steps * profile.speed(np.array([middle]))[0]
        x, y, yaw, *_ = (column[0] for column in path.sample(np.array([s, travelled])[:1]))
        x0 = state(x, y, yaw)
        x0[2] = profile.speed(np.array([s]))[0]
        reference, widths, found = horizon_reference(path, profile, x0, 0.05, 20, s)
        assert found.s == pytest.approx(s, abs=1e-6)
        assert widths is not None
        assert (reference.shape, widths.shape) == ((21, 4), (21, 2))
        expected = np.array([column[0] for column in path.sample(np.array([travelled]))])
        np.testing.assert_allclose(reference[stage, :2], expected[:2], atol=1e-4)
        assert reference[stage, 3] == pytest.approx(expected[2], abs=1e-5)
        assert reference[stage, 2] == pytest.approx(profile.speed(np.array([travelled]))[0])


def test_a_path_without_widths_has_none_in_its_reference() -> None:
    path = Path.from_points(np.column_stack([np.arange(9.0), np.zeros(9)]), closed=False)
    profile = SpeedProfile.constant(path, 5.0)
    reference, widths, _ = horizon_reference(path, profile, state(7.0, 1.0, 20.0 * np.pi), 0.1, 9)
    assert widths is None
    np.testing.assert_allclose(reference[:, 0], 7.0 + 0.5 * np.arange(10), atol=1e-9)
    np.testing.assert_allclose(reference[:, 3], 20.0 * np.pi)


def test_refusals_say_what_was_expected() -> None:
    path = Path.rounded_rectangle()
    with pytest.raises(EgpError, match="at least 4 distinct points, got 2"):
        Path.from_points(np.zeros((2, 2)), closed=False)
    with pytest.raises(EgpError, match="too short for its two corners"):
        Path.rounded_rectangle(width=20.0)
    with pytest.raises(EgpError, match=r"fraction in .* for grip, got 1.5"):
        SpeedProfile(path, CAR, grip=1.5)
    with pytest.raises(EgpError, match="finite"):
        path.project(np.array([np.nan, 0.0]))
    with pytest.raises(EgpError, match=r"x of shape \(7,\)"):
        horizon_reference(path, SpeedProfile(path, CAR), np.zeros(6), 0.05, 20)


def test_a_profile_of_another_path_of_the_same_length_is_an_error() -> None:
    x = np.linspace(0.0, 100.0, 41)
    left = np.column_stack([x, 4.0 * np.sin(x / 15.0)])
    path, mirrored = (Path.from_points(left * [1.0, side], closed=False) for side in (1.0, -1.0))
    assert mirrored.length == path.length
    profile = SpeedProfile(path, CAR)
    x0 = state(1.0, 0.0, 0.2)
    with pytest.raises(InvalidArgumentError, match="the profile belongs to another path"):
        horizon_reference(mirrored, profile, x0, 0.05, 20)
    expected = horizon_reference(path, profile, x0, 0.05, 20)[0]
    wide = Path.from_points(left, closed=False, widths=np.full((41, 2), 3.0))
    for same in (path.with_friction([(0.0, "ice")]), Path.from_points(left, closed=False), wide):
        reference = horizon_reference(same, profile, x0, 0.05, 20)[0]
        np.testing.assert_array_equal(reference, expected)


def test_a_margin_that_is_negative_is_an_error_with_the_range() -> None:
    with pytest.raises(EgpError, match=r"expected 0 to less than 0\.05 .* for margin, got -1"):
        Path.iso_3888_2(1.6, margin=-1.0)


@pytest.mark.parametrize(
    "zones",
    [
        [[0.0, 0.5], [0.3, 1.0]],
        ([0.0, 0.5], [0.3, 1.0]),
        np.array([[0.0, 0.5], [0.3, 1.0]]),
        zip([0.0, 0.3], np.array([0.5, 1.0]), strict=True),
    ],
)
def test_zones_may_be_rows_of_any_form(zones: Zones) -> None:
    path = Path.rounded_rectangle()
    s = np.linspace(0.0, path.length, 50)
    told = path.with_friction([(0.0, 0.5), (0.3, 1.0)]).sample(s)[-1]
    np.testing.assert_array_equal(path.with_friction(zones).sample(s)[-1], told)
    split = path.with_friction([[0.0, 0.5, "ice"]])
    assert split.sample(np.zeros(1))[-1] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("zones", "found"),
    [
        (0.5, "got 0.5"),
        ([0.0, 0.5], "got 0.0"),
        ([(0.0,)], r"got \(0.0,\)"),
        ([("start", 0.5)], "got .'start', 0.5"),
        ([(0.0, None)], "got .0.0, None"),
    ],
)
def test_zones_of_another_form_are_named(zones: Zones, found: str) -> None:
    with pytest.raises(InvalidArgumentError, match=rf"zones: expected rows .*{found}"):
        Path.rounded_rectangle().with_friction(zones)
