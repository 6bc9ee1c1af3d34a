//! Plans of the speed ahead.
#![allow(clippy::unwrap_used)]

use egp_parameters::{OutOfRange, STANDARD_GRAVITY, VehicleParameters};
use egp_path::tracks::{Corner, RoundedRectangle};
use egp_path::{
    HorizonRows, Path, PathError, ReferenceStart, SpeedLimits, SpeedPlanner, SpeedProfile,
    horizon_reference,
};

fn lap() -> Path {
    RoundedRectangle::default().path().unwrap()
}

fn limits() -> SpeedLimits {
    SpeedLimits::of(&VehicleParameters::FORD_ESCORT)
}

/// Speeds of a plan at its places, for one friction everywhere.
fn plan(path: &Path, s: f64, v: Option<f64>, friction: f64) -> Vec<f64> {
    let mut planner = SpeedPlanner::new(path, &limits()).unwrap();
    let friction = vec![friction; planner.places()];
    let (start, step) = (planner.start(s), planner.step());
    let profile = planner.plan(s, v, &friction).unwrap();
    (0..friction.len())
        .map(|i| profile.speed(start + i as f64 * step))
        .collect()
}

#[test]
fn on_known_friction_the_plan_is_the_profile() {
    let path = lap();
    let profile = SpeedProfile::new(&path, &limits()).unwrap();
    for s in [0.0, 40.0, 77.7, 200.0, 395.0] {
        // The profile's friction is 1 on a path without zones. What the plan does not see yet may slow it later.
        let speeds = plan(&path, s, Some(profile.speed(s)), 1.0);
        for (i, speed) in speeds.iter().take(150).enumerate() {
            let expected = profile.speed(s + i as f64);
            assert!(
                (speed - expected).abs() < 0.5,
                "{s} {i}: {speed} {expected}"
            );
        }
    }
}

#[test]
fn in_a_tight_bend_a_plan_needs_no_more_than_the_grip() {
    let small = RoundedRectangle {
        length: 8.0,
        width: 4.0,
        corner: Corner {
            radius: 1.1,
            transition: 0.2,
        },
        track_width: 1.8,
    };
    let (path, limits, friction) = (small.path().unwrap(), limits(), 0.6);
    let mut planner = SpeedPlanner::new(&path, &limits).unwrap();
    assert!(planner.step() < 1.1 / 8.0);
    let believed = vec![friction; planner.places()];
    let plan = planner.plan(0.0, None, &believed).unwrap();
    let allowed = limits.lateral * limits.grip * friction * STANDARD_GRAVITY;
    // Half a lap; a place farther ahead counts as one behind the vehicle.
    let most = (0..1000)
        .map(|i| 0.01 * f64::from(i))
        .map(|s| plan.speed(s).powi(2) * path.sample(s).curvature.abs())
        .fold(0.0, f64::max);
    // With knots that are 1 m apart it is 1.06 times.
    assert!(most < 1.03 * allowed, "{most} {allowed}");
}

#[test]
fn a_vehicle_that_is_too_fast_brakes_with_all_grip() {
    let (path, friction) = (lap(), 0.3);
    let speeds = plan(&path, 20.0, Some(25.0), friction);
    let braking = limits().braking * limits().grip * friction * STANDARD_GRAVITY;
    for pair in speeds.windows(2).take(40) {
        let slowed = (pair[0].powi(2) - pair[1].powi(2)) / 2.0;
        assert!(
            (slowed - braking).abs() < 0.02 * braking,
            "{pair:?} {braking}"
        );
    }
}

/// A vehicle that drives as planned, for one friction everywhere: its largest deceleration, of which the plan allows
/// `braking grip mu g`, before it comes to `end`.
fn hardest_braking(path: &Path, limits: &SpeedLimits, friction: f64, end: f64) -> f64 {
    let mut planner = SpeedPlanner::new(path, limits).unwrap();
    let believed = vec![friction; planner.places()];
    let (mut s, mut v, mut hardest) = (0.0, 5.0, 0.0_f64);
    while s < end - 2.0 {
        let next = planner.plan(s, Some(v), &believed).unwrap().speed(s + 1.0);
        hardest = hardest.max((v * v - next * next) / 2.0);
        (s, v) = (s + 1.0, next);
    }
    hardest
}

#[test]
fn a_bend_or_an_end_behind_the_plan_is_reached_without_more_than_the_planned_braking() {
    let straight = (0..80).map(|i| [10.0 * f64::from(i), 0.0]);
    let hairpin = (1..=16).map(|i| {
        let angle = std::f64::consts::PI * f64::from(i) / 16.0;
        [800.0 + 8.0 * angle.sin(), 8.0 - 8.0 * angle.cos()]
    });
    let back = (1..10).map(|i| [800.0 - 10.0 * f64::from(i), 16.0]);
    let points: Vec<_> = straight.chain(hairpin).chain(back).collect();
    let path = Path::from_points(&points, false, None).unwrap();
    let friction = 0.16;
    let limits = limits();
    let allowed = limits.braking * limits.grip * friction * STANDARD_GRAVITY;
    assert!(hardest_braking(&path, &limits, friction, 800.0) < 1.01 * allowed);

    let points: Vec<_> = (0..=80).map(|i| [10.0 * f64::from(i), 0.0]).collect();
    let road = Path::from_points(&points, false, None).unwrap();
    let to_a_stop = SpeedLimits {
        end_speed: Some(0.0),
        ..limits
    };
    assert!(hardest_braking(&road, &to_a_stop, friction, 800.0) < 1.01 * allowed);
}

#[test]
fn on_a_lap_a_bend_behind_the_plan_is_reached_without_more_than_the_planned_braking() {
    // Two straights of 800 m, which are joined by half circles of 8 m.
    let half = |centre: f64, side: f64| {
        (0..=16).map(move |i| {
            let angle = std::f64::consts::PI * f64::from(i) / 16.0;
            [centre + side * 8.0 * angle.sin(), side * -8.0 * angle.cos()]
        })
    };
    let points: Vec<_> = (1..80)
        .map(|i| [10.0 * f64::from(i), -8.0])
        .chain(half(800.0, 1.0))
        .chain((1..80).map(|i| [800.0 - 10.0 * f64::from(i), 8.0]))
        .chain(half(0.0, -1.0))
        .collect();
    let path = Path::from_points(&points, true, None).unwrap();
    let (limits, friction) = (limits(), 0.16);
    let allowed = limits.braking * limits.grip * friction * STANDARD_GRAVITY;
    assert!(hardest_braking(&path, &limits, friction, 2.0 * path.length()) < 1.01 * allowed);
}

#[test]
fn a_standing_vehicle_drives_off() {
    let speeds = plan(&lap(), 0.0, Some(0.0), 0.8);
    assert!(speeds[0] > 0.0 && speeds[1] > 1.0);
    assert!(speeds.windows(2).take(20).all(|pair| pair[0] < pair[1]));
}

#[test]
fn the_speed_at_the_vehicle_does_not_depend_on_its_place_between_knots() {
    let points: Vec<[f64; 2]> = (0..100).map(|i| [f64::from(i) * 10.0, 0.0]).collect();
    let road = Path::from_points(&points, false, None).unwrap();
    let mut planner = SpeedPlanner::new(&road, &limits()).unwrap();
    let friction = vec![0.5; planner.places()];
    for v in [4.0, 12.0, 29.0] {
        let speeds: Vec<f64> = (0..300)
            .map(|i| {
                let s = 100.0 + 0.01 * f64::from(i);
                planner.plan(s, Some(v), &friction).unwrap().speed(s)
            })
            .collect();
        let (least, most) = speeds
            .iter()
            .fold((f64::INFINITY, 0.0_f64), |(least, most), &speed| {
                (least.min(speed), most.max(speed))
            });
        assert!(
            least > v && most - least < 0.002 * v,
            "{v}: {least} to {most}"
        );
    }
}

#[test]
fn less_friction_ahead_slows_the_plan_before_it() {
    let path = lap();
    let mut planner = SpeedPlanner::new(&path, &limits()).unwrap();
    let mut friction = vec![1.0; planner.places()];
    let fast = planner.plan(0.0, Some(10.0), &friction).unwrap().clone();
    friction[100..].fill(0.2);
    let slow = planner.plan(0.0, Some(10.0), &friction).unwrap();
    assert_eq!(fast.speed(10.0), slow.speed(10.0));
    assert!(slow.speed(100.0) < 0.6 * fast.speed(100.0));
    assert!(slow.speed(90.0) < fast.speed(90.0));
}

#[test]
fn the_reference_over_the_horizon_follows_a_plan_across_the_end_of_a_lap() {
    let path = lap();
    let mut planner = SpeedPlanner::new(&path, &limits()).unwrap();
    let friction = vec![0.8; planner.places()];
    let s = path.length() - 3.0;
    let place = path.sample(s);
    let profile = planner.plan(s, Some(10.0), &friction).unwrap();
    let start = ReferenceStart {
        position: [place.x, place.y],
        psi: place.yaw,
        catch_up_from: None,
        hint: Some(s),
    };
    let mut rows = HorizonRows::new(40);
    horizon_reference(&path, profile, &start, 0.02, &mut rows).unwrap();
    let reference = rows.reference();
    for pair in reference.windows(2) {
        let distance = (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
        let mean = 0.5 * (pair[0][2] + pair[1][2]);
        assert!((distance - 0.02 * mean).abs() < 1e-3, "{pair:?}");
    }
    assert!(reference[40][2] > 10.0);
}

#[test]
fn a_plan_holds_on_both_sides_of_its_start() {
    holds_on_both_sides(&lap());
    // The plan is longer than this lap.
    let circle = (0..48).map(|i| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / 48.0).sin_cos();
        [30.0 * cos, 30.0 * sin]
    });
    let circle: Vec<[f64; 2]> = circle.collect();
    holds_on_both_sides(&Path::from_points(&circle, true, None).unwrap());
}

fn holds_on_both_sides(path: &Path) {
    let mut planner = SpeedPlanner::new(path, &limits()).unwrap();
    let mut friction = vec![0.8; planner.places()];
    friction[40..].fill(0.2); // the plan brakes
    let mut speeds = |planned: f64, measured: f64| {
        let profile = planner.plan(planned, Some(14.0), &friction).unwrap();
        let place = path.sample(measured);
        let start = ReferenceStart {
            position: [place.x, place.y],
            psi: place.yaw,
            catch_up_from: None,
            hint: None,
        };
        let mut rows = HorizonRows::new(40);
        horizon_reference(path, profile, &start, 0.05, &mut rows).unwrap();
        (rows.reference().iter().map(|row| row[2])).collect::<Vec<_>>()
    };
    let end = path.length();
    for (planned, measured) in [(0.05, end - 0.02), (end - 0.05, 0.02), (10.005, 9.98)] {
        let [across, beside] = [measured, planned].map(|at| speeds(planned, at));
        for (a, b) in across.iter().zip(&beside) {
            assert!((a - b).abs() < 0.2, "{across:?} {beside:?}");
        }
    }
}

#[test]
fn numbers_out_of_range_are_errors() {
    let path = lap();
    let mut planner = SpeedPlanner::new(&path, &limits()).unwrap();
    let places = planner.places();
    let mut refused = |s: f64, v: f64, friction: Vec<f64>| {
        planner.plan(s, Some(v), &friction).unwrap_err().to_string()
    };
    assert!(refused(f64::NAN, 1.0, vec![1.0; places]).contains("arc length"));
    for v in [f64::INFINITY, 1e200, 1.1e4, -1e200] {
        let message = refused(0.0, v, vec![1.0; places]);
        assert!(
            message.contains("a speed within ±10000 m/s for v"),
            "{message}"
        );
    }
    assert!(refused(0.0, 1.0, vec![0.0; places]).contains("friction"));
    let short = refused(0.0, 1.0, vec![1.0; 3]);
    assert_eq!(
        short,
        format!("expected the friction at {places} places, got 3")
    );
    let start = SpeedLimits {
        start_speed: Some(1.0),
        ..limits()
    };
    let points: Vec<_> = (0..10).map(|i| [10.0 * f64::from(i), 0.0]).collect();
    let open = Path::from_points(&points, false, None).unwrap();
    for path in [&path, &open] {
        assert!(matches!(
            SpeedPlanner::new(path, &start),
            Err(PathError::Parameter(OutOfRange {
                name: "start_speed",
                ..
            }))
        ));
    }
}
