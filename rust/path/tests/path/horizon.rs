//! The reference over the horizon: timing against numerical integration, yaw, ends.

#![allow(clippy::unwrap_used)]

use std::f64::consts::{PI, TAU};

use egp_parameters::{OutOfRange, STANDARD_GRAVITY, VehicleParameters};
use egp_path::tracks::{Corner, RoundedRectangle};
use egp_path::{
    HorizonRows, Path, PathError, Projection, ReferenceStart, SpeedLimits, SpeedPlanner,
    SpeedProfile, Zone, horizon_reference,
};

/// The speed limits of the simulated car.
fn car() -> SpeedLimits {
    SpeedLimits::of(&VehicleParameters::FORD_ESCORT)
}

const DT: f64 = 0.05;

type Rows = (Vec<[f64; 4]>, Vec<[f64; 2]>, Projection);

fn reference(path: &Path, profile: &SpeedProfile, position: [f64; 2], psi: f64) -> Rows {
    follow(path, profile, &at(position, psi), 40)
}

/// A vehicle whose speed the reference does not depend on.
fn at(position: [f64; 2], psi: f64) -> ReferenceStart {
    ReferenceStart {
        position,
        psi,
        catch_up_from: None,
        hint: None,
    }
}

fn follow(path: &Path, profile: &SpeedProfile, start: &ReferenceStart, periods: usize) -> Rows {
    let mut rows = HorizonRows::new(periods);
    let found = horizon_reference(path, profile, start, DT, &mut rows).unwrap();
    let (reference, widths) = rows.into_parts();
    (reference, widths, found)
}

#[test]
fn stages_are_spaced_by_time_along_the_profile() {
    let path = RoundedRectangle::default().path().unwrap();
    let profile = SpeedProfile::new(&path, &car()).unwrap();
    for start in [0.0, 20.0, 37.0, 60.0, path.length() - 4.0] {
        let at = path.sample(start);
        let position = [at.x - at.yaw.sin(), at.y + at.yaw.cos()];
        let (rows, widths, found) = reference(&path, &profile, position, at.yaw);
        assert!((found.lateral - 1.0).abs() < 1e-6);
        let mut s = found.s;
        for (k, row) in rows.iter().enumerate() {
            let expected = path.sample(s);
            assert!(
                (row[0] - expected.x).hypot(row[1] - expected.y) < 1e-3,
                "stage {k} from {start}"
            );
            assert!((row[2] - profile.speed(s)).abs() < 1e-3);
            assert_eq!(widths[k].map(|w| (w * 1e9).round()), [3.5e9; 2]);
            for _ in 0..500 {
                s += DT / 500.0 * profile.speed(s + DT / 1000.0 * profile.speed(s));
            }
        }
    }
}

#[test]
fn yaw_is_unwrapped_relative_to_the_vehicle() {
    let path = RoundedRectangle::default().path().unwrap();
    let profile = SpeedProfile::constant(&path, 12.0).unwrap();
    for turns in [-3.0, 0.0, 5.0] {
        // The yaw of the upper side is pi, where atan2 jumps, and increases further in the corner after it.
        let start = path.length() / 2.0 + 30.0;
        let at = path.sample(start);
        let psi = PI + 0.1 + turns * TAU;
        let (rows, ..) = reference(&path, &profile, [at.x, at.y], psi);
        assert!((rows[0][3] - psi).abs() < 0.2);
        assert!(
            rows.windows(2)
                .all(|r| (r[1][3] - r[0][3]).abs() < 0.1 && r[1][3] >= r[0][3] - 1e-6)
        );
        assert!(rows[40][3] > rows[0][3] + 0.3);
    }
}

#[test]
fn past_an_open_end_the_reference_continues_straight() {
    let points: Vec<_> = (0..=20)
        .map(|i| [f64::from(i), 0.1 * f64::from(i)])
        .collect();
    let path = Path::from_points(&points, false, None).unwrap();
    let profile = SpeedProfile::constant(&path, 10.0).unwrap();
    let (rows, widths, found) = reference(&path, &profile, [30.0, 3.0], 0.0);
    assert!(found.s > path.length() && found.lateral.abs() < 1e-9);
    for (k, row) in rows.iter().enumerate() {
        let along = (row[0] - 30.0).hypot(row[1] - 3.0);
        assert!((along - 10.0 * DT * k as f64).abs() < 1e-6);
        assert!((row[1] / row[0] - 0.1).abs() < 1e-9 && row[2] == 10.0);
    }
    assert!(widths.iter().flatten().all(|w| w.is_infinite()));
}

#[test]
fn the_reference_stays_where_the_profile_stops() {
    let points: Vec<_> = (0..=20).map(|i| [f64::from(i), 0.0]).collect();
    let path = Path::from_points(&points, false, None).unwrap();
    let stop = SpeedLimits {
        end_speed: Some(0.0),
        ..car()
    };
    let profile = SpeedProfile::new(&path, &stop).unwrap();
    let (rows, ..) = reference(&path, &profile, [19.0, 0.0], 0.0);
    assert!((rows[40][0] - 20.0).abs() < 1e-9 && rows[40][2] == 0.0);
    let (rows, ..) = reference(&path, &profile, [21.0, 0.0], 0.0);
    assert!(
        rows.iter()
            .all(|row| (row[0] - 21.0).abs() < 1e-9 && row[2] == 0.0)
    );
}

#[test]
fn errors_name_the_invalid_argument() {
    let path = RoundedRectangle::default().path().unwrap();
    let profile = SpeedProfile::constant(&path, 10.0).unwrap();
    let other = RoundedRectangle {
        length: 150.0,
        ..RoundedRectangle::default()
    }
    .path()
    .unwrap();
    let ask = |path: &Path, x: f64, dt: f64| {
        let (start, mut rows) = (at([x, 0.0], 0.0), HorizonRows::new(2));
        horizon_reference(path, &profile, &start, dt, &mut rows).unwrap_err()
    };
    assert!(matches!(
        ask(&path, f64::NAN, DT),
        PathError::Parameter(OutOfRange { name: "p_x", .. })
    ));
    assert!(matches!(
        ask(&path, 0.0, 0.0),
        PathError::Parameter(OutOfRange { name: "dt", .. })
    ));
    assert_eq!(ask(&other, 0.0, DT), PathError::ForeignProfile);
}

#[test]
fn a_profile_belongs_to_one_curve_whatever_its_length_widths_and_friction_are() {
    let bend = |side: f64| -> Vec<[f64; 2]> {
        let points = (0..40).map(|i| 2.5 * f64::from(i));
        points.map(|x| [x, side * 4.0 * (x / 15.0).sin()]).collect()
    };
    let path = Path::from_points(&bend(1.0), false, None).unwrap();
    let profile = SpeedProfile::new(&path, &car()).unwrap();
    let mut planner = SpeedPlanner::new(&path, &car()).unwrap();
    let friction = vec![0.8; planner.places()];
    let plan = planner.plan(0.0, None, &friction).unwrap();
    let ask = |path: &Path, profile: &SpeedProfile| {
        let start = at([1.0, 0.0], 0.0);
        horizon_reference(path, profile, &start, DT, &mut HorizonRows::new(2))
    };
    let mirrored = Path::from_points(&bend(-1.0), false, None).unwrap();
    assert_eq!(mirrored.length(), path.length());
    for profile in [&profile, plan] {
        let error = ask(&mirrored, profile).unwrap_err();
        assert_eq!(error, PathError::ForeignProfile);
        assert_eq!(error.to_string(), "the profile belongs to another path");
        let again = Path::from_points(&bend(1.0), false, None).unwrap();
        let icy = path.clone().with_friction(&[Zone::new(0.0, 0.1)]).unwrap();
        let wide = Path::from_points(&bend(1.0), false, Some(&[[3.0; 2]; 40])).unwrap();
        for same in [again, icy, wide] {
            ask(&same, profile).unwrap();
        }
    }
}

#[test]
fn a_vehicle_behind_a_standing_start_is_led_on_to_the_path() {
    let points: Vec<_> = (0..20).map(|i| [10.0 * f64::from(i), 0.0]).collect();
    let path = Path::from_points(&points, false, None).unwrap();
    let path = path.with_friction(&[Zone::new(0.0, 0.5)]).unwrap();
    let limits = SpeedLimits {
        start_speed: Some(0.0),
        ..car()
    };
    let profile = SpeedProfile::new(&path, &limits).unwrap();
    let (at_start, ..) = reference(&path, &profile, [0.0, 0.0], 0.0);
    let (behind, _, found) = reference(&path, &profile, [-0.1, 0.0], 0.0);
    assert!((found.s + 0.1).abs() < 1e-9);
    assert_eq!(behind, at_start);
    assert!(behind[40][0] > 1.0 && behind[40][2] > 1.0);
}

#[test]
fn a_vehicle_far_below_the_profile_is_not_left_behind() {
    let path = RoundedRectangle::default().path().unwrap();
    let profile = SpeedProfile::new(&path, &car()).unwrap();
    let place = path.sample(20.0);
    let start = at([place.x, place.y], place.yaw);
    let with = |profile: &SpeedProfile, v_x: f64| {
        let catching_up = ReferenceStart {
            catch_up_from: Some(v_x),
            ..start
        };
        follow(&path, profile, &catching_up, 40)
    };
    // Up to 2 m/s below nothing changes.
    let (rows, widths, found) = follow(&path, &profile, &start, 40);
    let near = with(&profile, rows[0][2] - 1.99);
    assert_eq!(near, (rows.clone(), widths.clone(), found));
    let (slower, edges, _) = with(&profile, 0.0);
    assert_eq!(with(&profile, f64::NAN).0, slower);
    let mut s = found.s;
    for (k, row) in slower.iter().enumerate() {
        let v = 2.0 + k as f64 * DT;
        assert!((row[2] - v).abs() < 1e-12, "stage {k}: {}", row[2]);
        let expected = path.sample(s);
        assert!((row[0] - expected.x).hypot(row[1] - expected.y) < 1e-9);
        assert!((row[3] - place.yaw).abs() < 1.0);
        s += v * DT;
    }
    assert_eq!(edges.len(), widths.len());
    // The profile is not exceeded.
    let low = SpeedProfile::constant(&path, 2.5).unwrap();
    let (rows, ..) = with(&low, 0.0);
    assert_eq!((rows[0][2], rows[40][2]), (2.0, 2.5));
}

#[test]
fn a_plan_with_end_speed_zero_comes_to_rest_at_the_end() {
    let points: Vec<_> = (0..=20).map(|i| [6.17 * f64::from(i), 0.0]).collect();
    let path = Path::from_points(&points, false, None).unwrap();
    let end = path.length();
    let stop = SpeedLimits {
        end_speed: Some(0.0),
        ..car()
    };
    let mut planner = SpeedPlanner::new(&path, &stop).unwrap();
    let friction = vec![0.8; planner.places()];
    let mut rows = |before: f64, v: f64| {
        let profile = planner.plan(end - before, Some(v), &friction).unwrap();
        let rows = follow(&path, profile, &at([end - before, 0.0], 0.0), 800).0;
        let case = format!("{before} m before the end at {v} m/s: {rows:?}");
        assert!(
            rows.iter().flatten().all(|value| value.is_finite()),
            "{case}"
        );
        assert!(
            rows.windows(2).all(|pair| pair[0][0] <= pair[1][0]),
            "{case}"
        );
        // The speed does not rise again.
        let fastest = (1..rows.len()).rfind(|i| rows[*i][2] > rows[i - 1][2] + 1e-6);
        let fallen = (1..rows.len()).find(|i| rows[*i][2] < rows[i - 1][2] - 1e-6);
        assert!(
            fastest.is_none_or(|i| fallen.is_none_or(|k| i < k)),
            "{case}"
        );
        assert!(rows[rows.len() - 1][2] < 1e-6, "{case}");
        rows[rows.len() - 1][0]
    };
    let braking = car().braking * car().grip * 0.8 * STANDARD_GRAVITY;
    for before in [123.0, 60.0, 20.3, 5.0, 1.7, 1.0, 0.3, 0.01] {
        let able_to_stop = 0.9 * (2.0 * braking * before).sqrt().min(20.0);
        assert!((rows(before, able_to_stop) - end).abs() < 1e-6);
        let rest = rows(before, able_to_stop + 3.0);
        assert!(rest > end - 1e-6 && rest < end + 30.0, "{rest}");
        let rest = rows(before, 0.0);
        assert!(rest > end - 1.0 && rest < end + 1e-6, "{rest}");
    }
    for beyond in [0.0, 0.01, 0.4, 1.0, 3.0, 40.0] {
        assert!((rows(-beyond, 0.0) - (end + beyond)).abs() < 1e-9);
        assert!(rows(-beyond, 3.0) > end + beyond);
    }

    let profile = planner.plan(100.0, Some(5.0), &friction).unwrap();
    let (last, never) = (profile.time(end), profile.time(end + 1.0));
    assert!(
        last > 0.0 && last < 30.0 && never == f64::INFINITY,
        "{last} {never}"
    );
    assert!((profile.station(last + 1e3) - end).abs() < 1e-9);
    assert_eq!(profile.lap_time(), f64::INFINITY);
}

/// A plan that is longer than the lap: the speeds of all stages are those of the distances between them.
#[test]
fn speeds_and_positions_agree_over_more_than_a_lap() {
    let path = RoundedRectangle {
        length: 24.0,
        width: 16.0,
        corner: Corner {
            radius: 5.0,
            transition: 3.0,
        },
        ..RoundedRectangle::default()
    };
    let path = path.path().unwrap();
    let mut planner = SpeedPlanner::new(&path, &car()).unwrap();
    let friction = vec![0.8; planner.places()];
    for start in [0.0, 0.6 * path.length()] {
        let from = path.sample(start);
        let profile = planner.plan(start, Some(0.5), &friction).unwrap();
        let rows = follow(&path, profile, &at([from.x, from.y], from.yaw), 400).0;
        let driven = |pair: &[[f64; 4]]| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
        assert!(rows.windows(2).map(driven).sum::<f64>() > path.length());
        for (stage, pair) in rows.windows(2).enumerate() {
            let mean = 0.5 * (pair[0][2] + pair[1][2]);
            let speed = driven(pair) / DT;
            assert!(
                (speed - mean).abs() < 0.02 * mean + 0.1,
                "{start} {stage}: {speed} {mean}"
            );
        }
    }
}
