//! The geometry of paths: comparison with closed forms, and projection as the inverse of sampling.

#![allow(clippy::unwrap_used)]

use std::f64::consts::{PI, TAU};

use egp_parameters::{Surface, SurfaceError};
use egp_path::tracks::RoundedRectangle;
use egp_path::{Path, PathError, Zone};
use proptest::prelude::*;

pub(crate) fn circle(radius: f64, count: usize) -> Path {
    let points: Vec<_> = (0..count)
        .map(|i| {
            let (sin, cos) = (TAU * i as f64 / count as f64).sin_cos();
            [radius * cos, radius * sin]
        })
        .collect();
    Path::from_points(&points, true, None).unwrap()
}

/// A closed path that crosses itself in the origin.
fn figure_eight() -> Path {
    let points: Vec<_> = (0..80)
        .map(|i| {
            let t = TAU * f64::from(i) / 80.0;
            [40.0 * t.sin(), 20.0 * (2.0 * t).sin()]
        })
        .collect();
    Path::from_points(&points, true, None).unwrap()
}

pub(crate) fn wave() -> Path {
    let points: Vec<_> = (0..60)
        .map(|i| f64::from(i) * 2.5)
        .map(|x| [x, 4.0 * (x / 15.0).sin()])
        .collect();
    Path::from_points(&points, false, None).unwrap()
}

fn beside(path: &Path, s: f64, lateral: f64) -> [f64; 2] {
    let at = path.sample(s);
    [at.x - lateral * at.yaw.sin(), at.y + lateral * at.yaw.cos()]
}

/// Distance along a closed path in the shorter direction.
fn apart(path: &Path, a: f64, b: f64) -> f64 {
    let gap = path.wrap(a - b);
    gap.min(path.length() - gap)
}

#[test]
fn a_circle_has_its_length_curvature_and_yaw() {
    let path = circle(25.0, 120);
    assert!(
        (path.length() - TAU * 25.0).abs() < 1e-4,
        "{}",
        path.length()
    );
    for i in 0..500 {
        let s = f64::from(i) * 0.6;
        let at = path.sample(s);
        assert!((at.x.hypot(at.y) - 25.0).abs() < 1e-5);
        assert!((at.curvature - 0.04).abs() < 1e-4, "{}", at.curvature);
        let yaw = s / 25.0 + PI / 2.0;
        assert!(((at.yaw - yaw) / TAU - ((at.yaw - yaw) / TAU).round()).abs() < 1e-6);
    }
}

#[test]
fn the_parameter_is_arc_length_also_over_uneven_waypoints() {
    let points: Vec<_> = [
        0.0, 1.0, 7.0, 9.0, 20.0, 26.0, 29.0, 45.0, 46.0, 60.0, 62.0, 70.0,
    ]
    .map(|x: f64| [x, 6.0 * (x / 11.0).sin()])
    .to_vec();
    for path in [
        Path::from_points(&points, false, None).unwrap(),
        figure_eight(),
        wave(),
    ] {
        let h = path.length() / 50_000.0;
        let mut travelled = 0.0;
        for i in 0..50_000 {
            let s = f64::from(i) * h;
            let (a, b) = (path.sample(s), path.sample(s + h));
            let chord = (b.x - a.x).hypot(b.y - a.y);
            assert!((chord / h - 1.0).abs() < 2e-6, "at {s}: {}", chord / h);
            travelled += chord;
        }
        assert!((travelled / path.length() - 1.0).abs() < 1e-6);
    }
}

#[test]
fn curvature_is_the_rate_of_yaw_and_continuous_over_the_seam() {
    let path = RoundedRectangle::default().path().unwrap();
    let h = 1e-4;
    for i in 0..2000 {
        let s = -5.0 + f64::from(i) * path.length() / 1990.0;
        let (a, b) = (path.sample(s - h), path.sample(s + h));
        let turn = (b.yaw - a.yaw) - TAU * ((b.yaw - a.yaw) / TAU).round();
        assert!((turn / (2.0 * h) - path.sample(s).curvature).abs() < 1e-5);
        assert!((b.curvature - a.curvature).abs() < 1e-5);
    }
}

/// Interpolation at the end of the last piece rounds.
#[test]
fn a_track_that_narrows_to_nothing_has_no_negative_width() {
    for spacing in 1..400 {
        let spacing = 1.0 + 0.01 * f64::from(spacing);
        let points = [0.0, 1.0, 2.0, 3.0, 4.0].map(|x| [x * spacing, 0.0]);
        let widths = [3.0, 3.0, 3.0, 3.0, 0.0].map(|width| [width; 2]);
        let path = Path::from_points(&points, false, Some(&widths)).unwrap();
        let end = path.sample(path.length());
        assert!((0.0..1e-9).contains(&end.left) && (0.0..1e-9).contains(&end.right));
    }
}

#[test]
fn an_open_path_continues_straight_beyond_its_ends() {
    let path = wave();
    let end = path.sample(path.length());
    let past = path.sample(path.length() + 10.0);
    assert!(((past.x - end.x) - 10.0 * end.yaw.cos()).abs() < 1e-5);
    assert_eq!((past.yaw, past.curvature), (end.yaw, 0.0));
    for (s, lateral) in [(-7.0, 1.0), (path.length() + 30.0, -2.0)] {
        for hint in [None, Some(s), Some(path.length() / 2.0)] {
            let found = path.project(beside(&path, s, lateral), hint);
            if hint == Some(path.length() / 2.0) && (found.s - s).abs() > 1.0 {
                continue; // a distant hint may lead to a local minimum
            }
            assert!((found.s - s).abs() < 1e-5, "{found:?} for {s}");
            assert!((found.lateral - lateral).abs() < 1e-5);
        }
    }
}

#[test]
fn a_closed_lap_is_projected_over_its_seam() {
    let path = RoundedRectangle::default().path().unwrap();
    for i in -50..50 {
        let s = f64::from(i) * 0.02;
        let position = beside(&path, s, 0.7);
        for hint in [None, Some(s - 0.5), Some(s + 0.5 + path.length())] {
            let found = path.project(position, hint);
            assert!((0.0..path.length()).contains(&found.s));
            assert!(apart(&path, found.s, s) < 1e-6, "{} for {s}", found.s);
            assert!((found.lateral - 0.7).abs() < 1e-6);
        }
    }
}

#[test]
fn a_hint_chooses_the_branch_where_the_path_crosses_itself() {
    let path = figure_eight();
    let half = path.length() / 2.0;
    // Beside the crossing, nearer to the second branch than to the first.
    let position = beside(&path, half + 0.5, 0.2);
    let first = path.project(position, Some(path.length() - 0.5));
    let second = path.project(position, Some(half - 1.0));
    assert!(apart(&path, first.s, 0.0) < 2.0 && (second.s - half).abs() < 2.0);
    assert!(first.lateral.abs() > second.lateral.abs());
    assert_eq!(path.project(position, None).s, second.s);
}

#[test]
fn driving_a_lap_with_the_last_station_as_hint_never_leaves_the_branch() {
    for path in [figure_eight(), RoundedRectangle::default().path().unwrap()] {
        let mut hint = path.project(beside(&path, 1.0, 0.3), Some(0.0)).s;
        for i in 0..2000 {
            let s = 1.0 + f64::from(i) * 0.5;
            let found = path.project(beside(&path, s, 0.3), Some(hint));
            assert!(apart(&path, found.s, s) < 1e-4, "{} for {s}", found.s);
            hint = found.s;
        }
    }
}

#[test]
fn widths_and_friction_follow_the_arc_length() {
    let points: Vec<_> = (0..20).map(|i| [f64::from(i) * 5.0, 0.0]).collect();
    let widths: Vec<_> = (0..20).map(|i| [3.0 + 0.1 * f64::from(i), 2.0]).collect();
    let zones =
        [(0.0, 0.5), (0.4, 0.8), (0.9, 1.1)].map(|(start, friction)| Zone::new(start, friction));
    let path = Path::from_points(&points, false, Some(&widths))
        .unwrap()
        .with_friction(&zones)
        .unwrap();
    let at = path.sample(47.5);
    assert!((at.left - 3.95).abs() < 1e-9 && (at.right - 2.0).abs() < 1e-12);
    assert!((path.sample(200.0).left - 4.9).abs() < 1e-9);
    let friction = [-1.0, 0.0, 37.9, 38.1, 85.4, 85.6, 95.0, 99.0].map(|s| path.friction(s));
    assert_eq!(friction, [0.5, 0.5, 0.5, 0.8, 0.8, 1.1, 1.1, 1.1]);
}

#[test]
fn a_split_road_has_two_sides() {
    let points: Vec<_> = (0..20).map(|i| [f64::from(i) * 5.0, 0.0]).collect();
    let split = Zone {
        right: Some(0.5.into()),
        ..Zone::new(0.5, 1.1)
    };
    let path = Path::from_points(&points, false, None)
        .unwrap()
        .with_friction(&[Zone::new(0.0, 0.8), split])
        .unwrap();
    let beside = [(10.0, 1.0), (10.0, -1.0), (60.0, 1.0), (60.0, -1.0)]
        .map(|(s, lateral)| path.surface_beside(s, lateral).friction());
    assert_eq!(beside, [0.8, 0.8, 1.1, 0.5]);
    assert_eq!(path.sample(60.0).friction, 0.8);
    for hint in [None, Some(40.0)] {
        let surfaces = path.surfaces_near(hint);
        let under = [[46.0, 1.0], [46.0, -1.0], [49.0, 1.0], [49.0, -1.0]]
            .map(|position| surfaces(position).friction());
        assert_eq!(under, [0.8, 0.8, 1.1, 0.5]);
    }
    let slick = Zone {
        right: Some(0.0.into()),
        ..split
    };
    let error = path.clone().with_friction(&[Zone::new(0.0, 0.8), slick]);
    assert_eq!(
        error.unwrap_err(),
        PathError::Surface(SurfaceError::Peak(0.0))
    );
    // The friction of a surface with a shape is its peak.
    let icy = Zone {
        right: Some(Surface::ICE),
        ..Zone::new(0.0, Surface::SNOW)
    };
    let path = path.with_friction(&[icy]).unwrap();
    assert_eq!(path.surface_beside(10.0, 1.0), Surface::SNOW);
    assert_eq!(path.surface_beside(10.0, -1.0), Surface::ICE);
    assert_eq!(path.friction(10.0), 0.2);
}

#[test]
fn a_path_shorter_than_any_vehicle_is_an_error() {
    let line = |length: f64| {
        let points = [0.0, 0.3, 0.6, 1.0].map(|share| [share * length, 0.0]);
        Path::from_points(&points, false, None)
    };
    line(0.101).unwrap();
    let error = line(0.099).unwrap_err().to_string();
    assert!(
        error.contains("the path's length") && error.contains("at least 0.1 m"),
        "{error}"
    );
}

#[test]
fn a_repeated_closing_point_is_dropped() {
    let mut square = vec![[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]];
    let without = Path::from_points(&square, true, None).unwrap();
    square.push(square[0]);
    let with = Path::from_points(&square, true, Some(&[[1.0; 2]; 5])).unwrap();
    assert_eq!(without.length(), with.length());
    // A second closing point is a repeated one.
    square.push(square[0]);
    let twice = Path::from_points(&square, true, None).unwrap_err();
    assert_eq!(twice, PathError::RepeatedPoint(4));
}

#[test]
fn errors_name_the_invalid_points() {
    let line = |n: u32| (0..n).map(|i| [f64::from(i), 0.0]).collect::<Vec<_>>();
    let open = |points: &[[f64; 2]]| Path::from_points(points, false, None).unwrap_err();
    assert_eq!(open(&line(3)), PathError::TooFewPoints(3));
    let mut points = line(6);
    points[4] = points[3];
    assert_eq!(open(&points), PathError::RepeatedPoint(3));
    points[4][1] = f64::NAN;
    assert!(matches!(
        open(&points),
        PathError::NotFinite { index: 4, .. }
    ));
    // The distance to such a point overflows.
    points[4][1] = f64::MAX;
    assert!(matches!(
        open(&points),
        PathError::NotFinite { index: 4, .. }
    ));
    // There and back: the cusps coincide with samples.
    let to_and_fro: [&[f64]; 2] = [&[0.0, 10.0, 20.0, 10.0], &[0.0, 4.0, 8.0, 4.0]];
    for x in to_and_fro {
        let points: Vec<[f64; 2]> = x.iter().map(|x| [*x, 0.0]).collect();
        let error = Path::from_points(&points, true, None).unwrap_err();
        assert!(matches!(error, PathError::TooSharp { .. }), "{error}");
    }
    // Of a line with one point beside it this one is named.
    let mut points = line(200);
    points[120][1] += 50.0 * (points[1][0] - points[0][0]);
    match open(&points) {
        PathError::TooSharp { point, x, .. } => {
            assert!((118..=121).contains(&point), "{point}");
            assert_eq!(x, points[point][0]);
        }
        error => unreachable!("{error}"),
    }
    // A bend after 100 km, on which pieces of half a metre are too many.
    let mut far: Vec<[f64; 2]> = (0..20_000).map(|i| [5.0 * f64::from(i), 0.0]).collect();
    far.extend((1..20).map(|i| {
        let turned = 0.1 * f64::from(i);
        [99_995.0 + 20.0 * turned.sin(), 20.0 - 20.0 * turned.cos()]
    }));
    assert!(matches!(open(&far), PathError::TooLong { .. }));
    let error = Path::from_points(&line(5), false, Some(&[[1.0, -1.0]; 5])).unwrap_err();
    assert!(matches!(
        error,
        PathError::NotFinite {
            what: "widths of at least 0",
            ..
        }
    ));
    let error = Path::from_points(&line(5), false, Some(&[[1.0; 2]; 4])).unwrap_err();
    assert_eq!(
        error,
        PathError::WidthCount {
            expected: 5,
            got: 4
        }
    );
    let zone = Zone::new(0.1, 1.0);
    let error = wave().with_friction(&[zone]).unwrap_err();
    assert_eq!(
        error,
        PathError::ZoneStart {
            index: 0,
            start: 0.1
        }
    );
}

proptest! {
    #[test]
    fn projection_inverts_an_offset(at in 0.0..1.0_f64, lateral in -6.0..6.0_f64, guess in -3.0..3.0_f64) {
        for path in [RoundedRectangle::default().path().unwrap(), wave()] {
            let s = at * path.length();
            let position = beside(&path, s, lateral);
            for hint in [None, Some(s + guess)] {
                let found = path.project(position, hint);
                prop_assert!((found.s - s).abs() < 1e-5, "{} for {s}", found.s);
                prop_assert!((found.lateral - lateral).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn no_point_of_the_path_is_nearer_than_the_projection(x in -60.0..60.0_f64, y in -40.0..40.0_f64) {
        let path = figure_eight();
        let found = path.project([x, y], None);
        let distance = |s: f64| { let at = path.sample(s); (at.x - x).hypot(at.y - y) };
        prop_assert!((distance(found.s) - found.lateral.abs()).abs() < 1e-6);
        for i in 0..3000 {
            prop_assert!(distance(found.s) <= distance(f64::from(i) * path.length() / 3000.0) + 1e-9);
        }
    }
}

#[test]
fn points_that_rounding_does_not_tell_apart_are_an_error() {
    let far = (0..100).map(|i| [if i % 2 == 0 { 1e8 } else { -1e8 }, f64::from(i)]);
    let close = [[0.0, 0.0], [1.5e-6, 0.0]];
    let points: Vec<_> = far.chain(close).collect();
    for closed in [false, true] {
        let error = Path::from_points(&points, closed, None).unwrap_err();
        assert_eq!(error, PathError::TooClose);
    }
}
