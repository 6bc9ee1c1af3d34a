//! Limits of a vehicle, and their comparison with the vehicle that plans are made for.
#![allow(clippy::unwrap_used, clippy::float_cmp)]

use egp_gate::{Gate, Limits};
use egp_parameters::VehicleParameters;

/// The limits of the simulated car.
fn car() -> Limits {
    Limits::of(&VehicleParameters::FORD_ESCORT)
}

#[test]
fn the_limits_of_a_vehicle_are_its_accelerations_times_its_mass() {
    let limits = car();
    assert_eq!(limits.mass, 1225.887);
    assert!((limits.force_min + 9807.096).abs() < 1e-9);
    assert!((limits.force_max - 7355.322).abs() < 1e-9);
    assert!((limits.power - 67_056.018_9).abs() < 1e-9);
    assert!((limits.force_slew - 73_553.22).abs() < 1e-9);
    assert_eq!(
        (
            limits.steering_angle,
            limits.steering_rate,
            limits.steering_slew
        ),
        (0.91, 0.4, 8.0)
    );
}

#[test]
fn the_stop_of_a_vehicle_with_weak_brakes_is_what_they_can_do() {
    assert_eq!(car().stop_deceleration(), 3.0);
    for a_min in [-0.1, -1.0 / 3.0, -2.0, -2.9] {
        let limits = Limits::of(&VehicleParameters {
            a_min,
            ..VehicleParameters::FORD_ESCORT
        });
        assert!((limits.stop_deceleration() + a_min).abs() < 1e-12);
        Gate::new(limits, 0.02, 25, limits.stop_deceleration()).unwrap();
        let told = Gate::new(limits, 0.02, 25, 3.0).unwrap_err().to_string();
        assert!(
            told.contains("stop_deceleration is 3 m/s², the limits allow at most"),
            "{told}"
        );
    }
}

#[test]
fn a_gate_wider_than_the_planned_vehicle_is_told_with_both_numbers() {
    let planned = VehicleParameters::FORD_ESCORT;
    let at_fault = |limits: Limits| limits.check_within(&planned).unwrap_err();
    assert_eq!(car().check_within(&planned), Ok(()));
    let narrow = Limits {
        force_min: -5000.0,
        steering_rate: 0.3,
        ..car()
    };
    assert_eq!(narrow.check_within(&planned), Ok(()));
    for share in [0.991, 1.009] {
        let mass = share * planned.mass;
        let rounded = Limits { mass, ..car() };
        assert_eq!(rounded.check_within(&planned), Ok(()), "{share}");
    }
    let wide = |name, change: fn(&mut Limits)| {
        let mut limits = car();
        change(&mut limits);
        assert_eq!(at_fault(limits).name, name);
    };
    wide("mass", |limits| limits.mass *= 1.011);
    wide("mass", |limits| limits.mass *= 0.989);
    wide("mass", |limits| limits.mass = f64::NAN);
    wide("force_min", |limits| limits.force_min = -9900.0);
    wide("force_max", |limits| limits.force_max = f64::NAN);
    wide("power", |limits| limits.power *= 1.001);
    wide("force_slew", |limits| limits.force_slew *= 1.001);
    wide("steering_angle", |limits| limits.steering_angle = 0.92);
    wide("steering_rate", |limits| limits.steering_rate = 0.41);
    wide("steering_slew", |limits| limits.steering_slew = 8.01);
    let error = at_fault(Limits {
        steering_rate: 0.6,
        ..car()
    });
    assert_eq!(
        error.to_string(),
        "gate limit steering_rate is 0.6 rad/s, the vehicle that plans are made for has 0.4 rad/s; \
         narrow the gate, or use a library trained for the gate's vehicle"
    );
    let error = at_fault(Limits {
        mass: 1284.0,
        ..car()
    });
    assert_eq!(
        error.to_string(),
        "gate limit mass is 1284 kg, the vehicle that plans are made for has 1225.887 kg; take the gate's limits from \
         the vehicle that the library was trained for (a scenario states its file as `vehicle_file`), or use a library \
         trained for the gate's vehicle"
    );
}

#[test]
fn the_limits_of_the_same_vehicle_with_another_load_fit_within_one_per_cent_of_its_mass() {
    let planned = VehicleParameters::FORD_ESCORT;
    let loaded = |share: f64| {
        let mass = share * planned.mass;
        Limits::of(&VehicleParameters { mass, ..planned })
    };
    for share in [0.991, 1226.0 / planned.mass, 1.009] {
        assert_eq!(loaded(share).check_within(&planned), Ok(()), "{share}");
    }
    assert_eq!(
        loaded(1.011).check_within(&planned).unwrap_err().name,
        "mass"
    );
    // A heavier gate allows no more acceleration, and a lighter one no more force.
    for (share, factor) in [(1.009, 1.000_01), (0.991, 1.009_1), (1.0, 1.000_01)] {
        let limits = loaded(share);
        for change in [
            |limits: &mut Limits, factor: f64| limits.force_min *= factor,
            |limits: &mut Limits, factor: f64| limits.force_max *= factor,
            |limits: &mut Limits, factor: f64| limits.power *= factor,
            |limits: &mut Limits, factor: f64| limits.force_slew *= factor,
        ] {
            let mut wide = limits;
            change(&mut wide, factor);
            assert!(wide.check_within(&planned).is_err(), "{share}");
        }
        let mut wide = limits;
        wide.steering_angle *= 1.000_01;
        assert_eq!(
            wide.check_within(&planned).unwrap_err().name,
            "steering_angle"
        );
    }
    let error = Limits {
        mass: 1230.0,
        force_max: 7500.0,
        ..car()
    };
    let told = error.check_within(&planned).unwrap_err().to_string();
    assert!(
        told.starts_with(
            "gate limit force_max is 7500 N, the vehicle that plans are made for has 7355.322 N at 1225.887 kg, which \
             is 7380 N at the gate's mass of 1230 kg; narrow the gate"
        ),
        "{told}"
    );
}

#[test]
fn the_limit_that_a_message_states_fits_a_small_vehicle_too() {
    let mass = 2.525_113_15;
    let planned = VehicleParameters {
        mass,
        ..VehicleParameters::FORD_ESCORT
    };
    let mut gate = Limits::of(&VehicleParameters {
        mass: 1.009 * mass,
        ..planned
    });
    gate.force_max *= 2.0;
    let told = gate.check_within(&planned).unwrap_err().to_string();
    let stated = told.split("which is ").nth(1).unwrap();
    gate.force_max = stated.split(' ').next().unwrap().parse().unwrap();
    assert_eq!(gate.check_within(&planned), Ok(()), "{told}");
}

#[test]
#[allow(clippy::cast_possible_truncation)] // is what the test is about
fn limits_in_single_precision_fit() {
    let single = |value: f64| f64::from(value as f32);
    let limits = car();
    let rounded = Limits {
        mass: single(limits.mass),
        force_min: single(limits.force_min),
        force_max: single(limits.force_max),
        power: single(limits.power),
        force_slew: single(limits.force_slew),
        steering_angle: single(limits.steering_angle),
        steering_rate: single(limits.steering_rate),
        steering_slew: single(limits.steering_slew),
    };
    assert!(rounded.steering_angle > limits.steering_angle);
    assert_eq!(
        rounded.check_within(&VehicleParameters::FORD_ESCORT),
        Ok(())
    );
    let strongest = single(-limits.force_min / limits.mass);
    Gate::new(rounded, 0.02, 25, strongest).unwrap();
}

#[test]
fn an_absurd_steering_slew_gives_a_finite_command() {
    for steering_slew in [5e-324, 1e-310, 1e-304, 1e-160, 1e307, f64::MAX] {
        let limits = Limits {
            steering_slew,
            ..car()
        };
        for dt in [1e-4, 10.0] {
            let mut gate = Gate::new(limits, dt, 3, 3.0).unwrap();
            gate.accept(0, &[[0.0, 0.1]]).unwrap();
            let rate = gate.command(0, 10.0, 0.0).u[1];
            assert!(
                (0.0..=0.1).contains(&rate),
                "{rate} of {steering_slew}, {dt} s"
            );
        }
    }
}
