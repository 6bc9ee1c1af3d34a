//! Speed profiles: comparison with closed forms, and the limits checked by finite differences.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::f64::consts::TAU;

use egp_parameters::{OutOfRange, VehicleParameters};
use egp_path::tracks::RoundedRectangle;
use egp_path::{Path, PathError, SpeedLimits, SpeedProfile, Zone};
use proptest::prelude::*;

/// The speed limits of the simulated car.
fn car() -> SpeedLimits {
    SpeedLimits::of(&VehicleParameters::FORD_ESCORT)
}

const G: f64 = 9.806_65;
/// Share of the tyres' lateral peak that a profile uses at most.
const SHARE: f64 = 0.95;

fn straight(length: f64) -> Path {
    let points: Vec<_> = (0..=10)
        .map(|i| [length * f64::from(i) / 10.0, 0.0])
        .collect();
    Path::from_points(&points, false, None).unwrap()
}

fn demo() -> Path {
    let zones =
        [(0.0, 0.5), (0.35, 0.8), (0.7, 1.1)].map(|(start, friction)| Zone::new(start, friction));
    RoundedRectangle::default()
        .path()
        .unwrap()
        .with_friction(&zones)
        .unwrap()
}

/// The largest violation of any limit relative to the limit, computed from speeds alone.
fn violation(path: &Path, limits: &SpeedLimits) -> f64 {
    let profile = SpeedProfile::new(path, limits).unwrap();
    let h = 0.01;
    let margin = if path.closed() { 0.0 } else { h };
    let count = 5000;
    let mut worst = f64::NEG_INFINITY;
    for i in 0..count {
        let s = margin + (path.length() - 2.0 * margin) * f64::from(i) / f64::from(count);
        let at = path.sample(s);
        let v = profile.speed(s);
        let a = (profile.speed(s + h).powi(2) - profile.speed(s - h).powi(2)) / (4.0 * h);
        let grip = limits.grip * at.friction * G;
        let (fraction, most) = if a > 0.0 {
            (limits.driving, limits.a_drive.min(limits.power / v))
        } else {
            (limits.braking, limits.a_brake)
        };
        let ellipse = (v * v * at.curvature / (limits.lateral * grip)).hypot(a / (fraction * grip));
        worst = worst
            .max(ellipse - 1.0)
            .max(a.abs() / most - 1.0)
            .max(v / limits.v_max - 1.0);
    }
    worst
}

#[test]
fn a_circle_is_driven_at_its_lateral_limit() {
    let points: Vec<_> = (0..200)
        .map(|i| (TAU * f64::from(i) / 200.0).sin_cos())
        .map(|(sin, cos)| [30.0 * cos, 30.0 * sin])
        .collect();
    let path = Path::from_points(&points, true, None).unwrap();
    let limits = SpeedLimits { grip: 0.9, ..car() };
    let profile = SpeedProfile::new(&path, &limits).unwrap();
    let speed = (0.9 * 0.88 * G * 30.0).sqrt();
    assert!((profile.speed(50.0) / speed - 1.0).abs() < 1e-4);
    assert!((profile.lap_time() * speed / path.length() - 1.0).abs() < 1e-4);
}

#[test]
fn a_drag_race_has_the_closed_form_of_constant_acceleration() {
    let path = straight(100.0)
        .with_friction(&[Zone::new(0.0, 0.5)])
        .unwrap();
    let limits = SpeedLimits {
        start_speed: Some(0.0),
        end_speed: Some(0.0),
        ..car()
    };
    let profile = SpeedProfile::new(&path, &limits).unwrap();
    let (drive, brake) = (0.8 * 0.22 * 0.5 * G, 0.8 * 0.45 * 0.5 * G);
    let turn = 100.0 * brake / (drive + brake);
    for s in [0.0, 1.0, 10.0, 30.0, 60.0] {
        assert!((profile.speed(s) - (2.0 * drive * s).sqrt()).abs() < 1e-9);
        assert!((profile.time(s) - (2.0 * s / drive).sqrt()).abs() < 1e-9);
    }
    for s in [turn + 1.0, 90.0, 99.0, 100.0] {
        assert!((profile.speed(s) - (2.0 * brake * (100.0 - s)).sqrt()).abs() < 1e-6);
    }
    assert!(profile.speed(-3.0) < 1e-6 && profile.speed(130.0) < 1e-6);
}

#[test]
fn every_limit_holds_everywhere_on_the_demo_lap() {
    for grip in [0.3, 0.82, 0.9, 1.0] {
        let limits = SpeedLimits { grip, ..car() };
        let worst = violation(&demo(), &limits);
        assert!(worst < 5e-3, "{worst} at grip {grip}");
        // Some limit is active: the profile is not merely slow.
        assert!(worst > -1e-3, "{worst} at grip {grip}");
    }
}

#[test]
fn the_demo_lap_closes_and_takes_half_a_minute() {
    let path = demo();
    let profile = SpeedProfile::new(
        &path,
        &SpeedLimits {
            grip: 0.82,
            ..car()
        },
    )
    .unwrap();
    assert!(
        (25.0..40.0).contains(&profile.lap_time()),
        "{}",
        profile.lap_time()
    );
    assert!((profile.speed(-1e-9) - profile.speed(1e-9)).abs() < 1e-6);
    let ahead = profile.time(path.length() + 10.0) - profile.time(path.length() - 10.0);
    let apart = profile.time(10.0) - profile.time(-10.0);
    assert!((ahead - apart).abs() < 1e-9);
}

#[test]
fn it_brakes_before_the_slippery_zone_and_not_inside() {
    let points: Vec<_> = (0..=50)
        .map(|i| [4.0 * f64::from(i), 12.0 * (f64::from(i) / 8.0).sin()])
        .collect();
    let path = Path::from_points(&points, false, None).unwrap();
    let zones = [(0.0, 1.1), (0.5, 0.4)].map(|(start, friction)| Zone::new(start, friction));
    assert!(violation(&path.with_friction(&zones).unwrap(), &car()) < 5e-3);
}

#[test]
fn bends_ask_for_at_most_a_share_of_what_the_tyres_transmit() {
    let points: Vec<_> = (0..200)
        .map(|i| (TAU * f64::from(i) / 200.0).sin_cos())
        .map(|(sin, cos)| [30.0 * cos, 30.0 * sin])
        .collect();
    let circle = Path::from_points(&points, true, None).unwrap();
    let limits = SpeedLimits {
        grip: 0.9,
        tyres: vec![[0.1, 0.5], [0.3, 0.7], [1.0, 0.87]],
        ..car()
    };
    // The tyres transmit 0.05, 0.21 and 0.87 g; on 1.0 and more this is more than the vehicle's own limit asks for.
    for (friction, asked) in [
        (0.05, SHARE * 0.25), // the line would leave 0.2
        (0.08, SHARE * 0.034 / 0.08),
        (0.1, SHARE * 0.5),
        (0.15, SHARE * 0.09 / 0.15),
        (0.3, SHARE * 0.7),
        (1.0, 0.9 * car().lateral),
        (1.2, 0.9 * car().lateral),
    ] {
        let road = circle
            .clone()
            .with_friction(&[Zone::new(0.0, friction)])
            .unwrap();
        let v = SpeedProfile::new(&road, &limits).unwrap().speed(1.0);
        let share = v * v / 30.0 / (friction * G);
        assert!(
            (share / asked - 1.0).abs() < 1e-3,
            "{friction}: {share} {asked}"
        );
    }
}

#[test]
fn errors_name_the_invalid_limit() {
    let reject = |path: &Path, limits: SpeedLimits| SpeedProfile::new(path, &limits).unwrap_err();
    let name = |error: PathError| match error {
        PathError::Parameter(OutOfRange { name, .. }) => name,
        other => panic!("{other}"),
    };
    let default = car();
    let open = straight(10.0);
    assert_eq!(
        name(reject(
            &open,
            SpeedLimits {
                grip: 1.2,
                ..default.clone()
            }
        )),
        "grip"
    );
    assert_eq!(
        name(reject(
            &open,
            SpeedLimits {
                power: f64::NAN,
                ..default.clone()
            }
        )),
        "power"
    );
    assert_eq!(
        name(reject(
            &open,
            SpeedLimits {
                end_speed: Some(-1.0),
                ..default.clone()
            }
        )),
        "end_speed"
    );
    assert_eq!(
        name(reject(
            &demo(),
            SpeedLimits {
                start_speed: Some(1.0),
                ..default.clone()
            }
        )),
        "start_speed"
    );
    for tyres in [
        vec![[0.5, 0.8], [0.5, 0.9]],
        vec![[0.5, -0.1]],
        vec![[f64::NAN, 0.8]],
    ] {
        let wrong = SpeedLimits {
            tyres,
            ..default.clone()
        };
        assert_eq!(name(reject(&open, wrong)), "tyres");
    }
    assert_eq!(
        name(SpeedProfile::constant(&open, 0.0).unwrap_err()),
        "speed"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn station_inverts_time(time in -100.0..200.0_f64) {
        for path in [demo(), straight(80.0)] {
            let profile = SpeedProfile::new(&path, &car()).unwrap();
            prop_assert!((profile.time(profile.station(time)) - time).abs() < 1e-8);
        }
    }

    #[test]
    fn profiles_satisfy_arbitrary_limits(grip in 0.1..1.0_f64, v_max in 2.0..40.0_f64, drop in 0.1..1.2_f64) {
        let path = demo().with_friction(&[
            Zone::new(0.0, 1.0),
            Zone::new(0.55, drop),
        ]).unwrap();
        let worst = violation(&path, &SpeedLimits { grip, v_max, ..car() });
        prop_assert!(worst < 5e-3, "{}", worst);
    }
}
