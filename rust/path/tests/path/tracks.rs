//! Built-in tracks: the dimensions of their definitions and the properties that all of them share.

#![allow(clippy::unwrap_used)]

use egp_parameters::VehicleParameters;
use egp_path::tracks::{
    Corner, DoubleLaneChange, LShape, LaneChanges, RandomTrack, RoundedRectangle,
};
use egp_path::{Path, SpeedLimits, SpeedProfile};
use proptest::prelude::*;

/// The simulated car.
const CAR: VehicleParameters = VehicleParameters::FORD_ESCORT;

const STEPS: u32 = 4000;

fn stations(path: &Path) -> impl Iterator<Item = f64> {
    let length = path.length();
    (0..=STEPS).map(move |i| length * f64::from(i) / f64::from(STEPS))
}

fn tightest(path: &Path) -> f64 {
    stations(path)
        .map(|s| path.sample(s).curvature.abs())
        .fold(0.0, f64::max)
}

/// Largest change of curvature per metre.
fn sharpness(path: &Path) -> f64 {
    let h = path.length() / f64::from(STEPS);
    stations(path)
        .map(|s| (path.sample(s + h).curvature - path.sample(s).curvature).abs() / h)
        .fold(0.0, f64::max)
}

#[test]
fn all_start_at_the_origin_along_x() {
    let paths = [
        RoundedRectangle::default().path(),
        LShape::default().path(),
        LaneChanges::default().path(),
        DoubleLaneChange::of(CAR.width).path(),
        RandomTrack::new(4).path(),
    ];
    for path in paths {
        let start = path.unwrap().sample(0.0);
        assert!(
            start.x.hypot(start.y) < 1e-5 && start.yaw.abs() < 1e-3,
            "{start:?}"
        );
    }
}

#[test]
fn corners_are_clothoids_about_arcs() {
    let corner = Corner {
        radius: 12.0,
        transition: 9.0,
    };
    let rectangle = RoundedRectangle {
        corner,
        ..RoundedRectangle::default()
    }
    .path()
    .unwrap();
    let l_shape = LShape {
        corner,
        ..LShape::default()
    }
    .path()
    .unwrap();
    for path in [&rectangle, &l_shape] {
        assert!(
            (tightest(path) * 12.0 - 1.0).abs() < 5e-3,
            "{}",
            tightest(path)
        );
        assert!(
            (sharpness(path) * 12.0 * 9.0 - 1.0).abs() < 0.25,
            "{}",
            sharpness(path)
        );
    }
    // Straights and corners add up: a corner of clothoids is `radius pi / 2 + transition` long.
    let x: Vec<_> = stations(&rectangle)
        .map(|s| rectangle.sample(s).x)
        .collect();
    let wide = x.iter().copied().fold(0.0, f64::max) - x.iter().copied().fold(0.0, f64::min);
    assert!((wide - 120.0).abs() < 1e-3);
    assert!(stations(&l_shape).any(|s| l_shape.sample(s).curvature < -0.08));
}

#[test]
fn lane_changes_swing_between_two_lanes() {
    let path = LaneChanges::default().path().unwrap();
    let y: Vec<_> = stations(&path).map(|s| path.sample(s).y).collect();
    assert!((y.iter().copied().fold(0.0, f64::max) - 2.5).abs() < 1e-4);
    assert!(y.iter().all(|&y| y > -1e-4) && y[y.len() - 1].abs() < 1e-6);
    assert_eq!(
        y.windows(2)
            .filter(|y| (y[0] - 1.25) * (y[1] - 1.25) < 0.0)
            .count(),
        8
    );
    let peak = 2.5 * 10.0 / 3.0_f64.sqrt() / 900.0;
    assert!((tightest(&path) / peak - 1.0).abs() < 0.01);
    assert!((path.sample(path.length()).x - 500.0).abs() < 1e-6);
}

#[test]
fn the_double_lane_change_has_the_dimensions_of_the_standard() {
    let [first, second, third] = DoubleLaneChange::of(2.0).sections();
    let close = |a: f64, b: f64| (a - b).abs() < 1e-12;
    assert!(close(first.left - first.right, 2.45) && close(second.left - second.right, 3.0));
    assert!(close(third.left - third.right, 3.0) && close(third.end, 61.0));
    assert!(close(second.right - first.left, 1.0) && close(third.right, first.right));
    assert!(close(second.start - first.end, 13.5) && close(third.start - second.end, 12.5));
}

#[test]
fn the_double_lane_changes_path_stays_between_the_cones_at_half_the_grip_of_lane_centres() {
    let course = DoubleLaneChange::of(CAR.width);
    let path = course.path().unwrap();
    let room = course.vehicle_width / 2.0 + course.margin;
    for s in stations(&path) {
        let at = path.sample(s);
        let from_cones = at.x - course.lead_in;
        for lane in course.sections() {
            if (lane.start..=lane.end).contains(&from_cones) {
                assert!(
                    at.y + room < lane.left + 2e-3 && at.y - room > lane.right - 2e-3,
                    "{at:?}"
                );
                assert!(
                    (at.y + at.left - lane.left).abs() < 5e-3
                        || from_cones - lane.start < 1.0
                        || lane.end - from_cones < 1.0
                );
            }
        }
        assert!(at.left >= room - 2e-3 && at.right >= room - 2e-3);
    }
    let acceleration = 15.0_f64.powi(2) * tightest(&path);
    assert!((6.0..11.0).contains(&acceleration), "{acceleration}");
    assert!(sharpness(&path) < 0.015, "{}", sharpness(&path));
}

#[test]
fn errors_explain_the_invalid_dimension() {
    let message = |path: Result<Path, egp_path::PathError>| path.unwrap_err().to_string();
    let rectangle = RoundedRectangle {
        width: 30.0,
        ..RoundedRectangle::default()
    };
    assert!(message(rectangle.path()).contains("too short for its two corners"));
    let corner = Corner {
        radius: 5.0,
        transition: 9.0,
    };
    assert!(
        message(
            RoundedRectangle {
                corner,
                ..rectangle
            }
            .path()
        )
        .contains("for transition, got 9")
    );
    assert!(
        message(
            LShape {
                arm: 200.0,
                ..LShape::default()
            }
            .path()
        )
        .contains("for each side, got -70")
    );
    assert!(
        message(
            LaneChanges {
                length: 90.0,
                ..LaneChanges::default()
            }
            .path()
        )
        .contains("which takes 120 m")
    );
    let course = DoubleLaneChange {
        margin: 0.3,
        ..DoubleLaneChange::of(CAR.width)
    };
    assert!(message(course.path()).contains("for margin, got 0.3"));
    assert!(
        message(
            RandomTrack {
                length: 100.0,
                ..RandomTrack::new(1)
            }
            .path()
        )
        .contains("which need 141 m")
    );
}

#[test]
fn a_seed_determines_its_track() {
    let at = |seed| RandomTrack::new(seed).path().unwrap().sample(100.0);
    assert_eq!(at(7), at(7));
    assert_ne!(at(7), at(8));
}

#[test]
fn on_the_shortest_lap_all_points_are_neighbours_and_only_the_radius_counts() {
    let min_radius = 10.0_f64.next_up();
    let track = RandomTrack {
        seed: 1,
        length: 1.5 * std::f64::consts::TAU * min_radius,
        min_radius,
        track_width: 20.0,
    };
    assert!(tightest(&track.path().unwrap()) * min_radius < 1.02);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(30))]

    #[test]
    fn random_tracks_can_be_driven(seed in any::<u64>(), length in 250.0..1500.0_f64, min_radius in 8.0..20.0_f64) {
        let path = RandomTrack { seed, length, min_radius, track_width: 7.0 }.path().unwrap();
        prop_assert!((path.length() / length - 1.0).abs() < 1e-3);
        prop_assert!(tightest(&path) * min_radius < 1.02);
        // No other stretch of the track is nearer than the edges, so each edge point projects back to its own point of
        // the path.
        for i in 0..150 {
            let s = path.length() * f64::from(i) / 150.0;
            let at = path.sample(s);
            for lateral in [-3.5, 3.5] {
                let edge = [at.x - lateral * at.yaw.sin(), at.y + lateral * at.yaw.cos()];
                let found = path.project(edge, None);
                prop_assert!((found.s - s).abs() < 1e-3 || path.length() - (found.s - s).abs() < 1e-3);
            }
        }
        SpeedProfile::new(&path, &SpeedLimits::of(&CAR)).unwrap();
    }
}
