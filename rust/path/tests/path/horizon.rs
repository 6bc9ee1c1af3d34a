//! The reference over the horizon: timing against numerical integration, yaw, ends.

#![allow(clippy::unwrap_used)]

use std::f64::consts::{PI, TAU};

use egp_parameters::VehicleParameters;
use egp_path::tracks::RoundedRectangle;
use egp_path::{
    Path, PathError, Projection, SpeedLimits, SpeedProfile, Zone, catch_up, horizon_reference,
};

/// The speed limits of the simulated car.
fn car() -> SpeedLimits {
    SpeedLimits::of(&VehicleParameters::FORD_ESCORT)
}

const DT: f64 = 0.05;

type Rows = (Vec<[f64; 4]>, Vec<[f64; 2]>, Projection);

fn reference(path: &Path, profile: &SpeedProfile, position: [f64; 2], psi: f64) -> Rows {
    let (mut rows, mut widths) = (vec![[0.0; 4]; 41], vec![[0.0; 2]; 41]);
    let found = horizon_reference(
        path,
        profile,
        position,
        psi,
        DT,
        None,
        &mut rows,
        &mut widths,
    )
    .unwrap();
    (rows, widths, found)
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
    let (mut rows, mut widths) = ([[0.0; 4]; 3], [[0.0; 2]; 2]);
    let mut ask = |path: &Path, x: f64, dt: f64| {
        horizon_reference(
            path,
            &profile,
            [x, 0.0],
            0.0,
            dt,
            None,
            &mut rows,
            &mut widths,
        )
        .unwrap_err()
    };
    assert!(matches!(
        ask(&path, f64::NAN, DT),
        PathError::Parameter { name: "p_x", .. }
    ));
    assert!(matches!(
        ask(&path, 0.0, 0.0),
        PathError::Parameter { name: "dt", .. }
    ));
    assert!(matches!(
        ask(&other, 0.0, DT),
        PathError::ForeignProfile { .. }
    ));
    assert_eq!(
        ask(&path, 0.0, DT),
        PathError::HorizonRows {
            reference: 3,
            widths: 2
        }
    );
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
    let at = path.sample(20.0);
    let (rows, widths, found) = reference(&path, &profile, [at.x, at.y], at.yaw);
    let with = |v_x: f64| {
        let (mut rows, mut widths) = (rows.clone(), widths.clone());
        catch_up(&path, &profile, found.s, v_x, DT, &mut rows, &mut widths);
        (rows, widths)
    };
    // Up to 2 m/s below nothing changes.
    assert_eq!(with(rows[0][2] - 1.99), (rows.clone(), widths.clone()));
    let (slower, edges) = with(0.0);
    let mut s = found.s;
    for (k, row) in slower.iter().enumerate() {
        let v = 2.0 + k as f64 * DT;
        assert!((row[2] - v).abs() < 1e-12, "stage {k}: {}", row[2]);
        let expected = path.sample(s);
        assert!((row[0] - expected.x).hypot(row[1] - expected.y) < 1e-9);
        assert!((row[3] - at.yaw).abs() < 1.0);
        s += v * DT;
    }
    assert_eq!(edges.len(), widths.len());
    // The profile is not exceeded.
    let low = SpeedProfile::constant(&path, 2.5).unwrap();
    let (mut rows, mut widths) = (vec![[0.0, 0.0, 2.5, at.yaw]; 41], vec![[0.0; 2]; 41]);
    catch_up(&path, &low, found.s, 0.0, DT, &mut rows, &mut widths);
    assert_eq!(rows[40][2], 2.5);
}
