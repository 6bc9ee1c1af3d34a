//! Whatever comes in, what goes out respects the limits.
#![allow(clippy::unwrap_used)]

use egp_gate::{Gate, GateError, Limits, Mode};
use egp_parameters::VehicleParameters;
use proptest::prelude::*;

const DT: f64 = 0.05;

/// The limits of the simulated car.
fn car() -> Limits {
    Limits::of(&VehicleParameters::FORD_ESCORT)
}

/// Slow steering slew, so that the look-ahead over several periods matters.
fn limits(steering_slew: f64) -> Limits {
    Limits {
        steering_slew,
        ..car()
    }
}

/// Any double, with the special ones common.
fn wild() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        -20_000.0..20_000.0,
        -1.0..1.0,
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY)
    ]
}

#[derive(Clone, Debug)]
enum Event {
    Plan(u64, Vec<[f64; 2]>),
    Measurement(f64, f64),
    Reset,
}

fn event() -> impl Strategy<Value = Event> {
    let plan = prop::collection::vec([wild(), wild()], 0..6);
    let tame = prop::collection::vec([-9e3..9e3, -0.6..0.6], 1..6);
    prop_oneof![
        1 => (0_u64..3, plan).prop_map(|(age, u)| Event::Plan(age, u)),
        4 => (0_u64..3, tame).prop_map(|(age, u)| Event::Plan(age, u)),
        1 => (wild(), wild()).prop_map(|(v_x, delta)| Event::Measurement(v_x, delta)),
        8 => (-5.0..60.0, -0.95..0.95).prop_map(|(v_x, delta)| Event::Measurement(v_x, delta)),
        1 => Just(Event::Reset),
    ]
}

proptest! {
    #[test]
    fn outputs_respect_value_and_slew_limits(
        events in prop::collection::vec(event(), 1..60),
        steering_slew in 0.05..10.0,
    ) {
        let limits = limits(steering_slew);
        let mut gate = Gate::new(limits, DT, 3, 3.0).unwrap();
        let (mut tick, mut previous) = (2, [0.0; 2]);
        for event in events {
            match event {
                Event::Plan(age, u) => { let _ = gate.accept(tick - age, &u); }
                Event::Reset => gate.reset(),
                Event::Measurement(v_x, delta) => {
                    let was = gate.mode();
                    let command = gate.command(tick, v_x, delta);
                    let [force, rate] = command.u;
                    let (df, dr) = (limits.force_slew * DT, limits.steering_slew * DT);
                    prop_assert!((limits.force_min..=limits.force_max).contains(&force));
                    prop_assert!(rate.abs() <= limits.steering_rate);
                    prop_assert!((force - previous[0]).abs() <= df * (1.0 + 1e-12));
                    prop_assert!((rate - previous[1]).abs() <= dr * (1.0 + 1e-12));
                    if v_x.is_finite() && v_x.abs() > 1.0 {
                        let ceiling = (limits.power / v_x.abs()).max(previous[0] - df);
                        prop_assert!(force <= ceiling + 1e-9);
                    }
                    prop_assert!(was != Mode::Stop || command.mode == Mode::Stop);
                    prop_assert!((v_x.is_finite() && delta.is_finite()) || command.mode == Mode::Stop);
                    previous = command.u;
                    tick += 1;
                }
            }
        }
    }

    #[test]
    fn the_steering_angle_stays_inside_its_limit(
        wanted in prop::collection::vec(-1.0..1.0, 1..200),
        steering_slew in 0.05..10.0,
        start in -0.91..0.91,
    ) {
        let limits = limits(steering_slew);
        let mut gate = Gate::new(limits, DT, 0, 3.0).unwrap();
        let mut delta: f64 = start;
        for (tick, rate) in (0..).zip(wanted) {
            gate.accept(tick, &[[0.0, rate]]).unwrap();
            delta += DT * gate.command(tick, 10.0, delta).u[1];
            prop_assert!(delta.abs() <= limits.steering_angle + 1e-12);
        }
    }

    #[test]
    fn without_new_plans_the_tail_ends_in_a_stop(length in 1_usize..20, max_tail in 0_u64..20) {
        let mut gate = Gate::new(car(), DT, max_tail, 3.0).unwrap();
        gate.accept(7, &vec![[100.0, 0.0]; length]).unwrap();
        let usable = (max_tail + 1).min(length as u64);
        for age in 0..usable + 5 {
            let expected = match age {
                0 => Mode::Normal,
                _ if age < usable => Mode::Tail,
                _ => Mode::Stop,
            };
            prop_assert_eq!(gate.command(7 + age, 10.0, 0.0).mode, expected);
        }
        prop_assert_eq!(gate.accept(100, &[[0.0, 0.0]]), Err(GateError::Stopped));
    }
}

#[test]
fn a_stop_brings_a_point_mass_to_rest_and_holds_it() {
    let limits = car();
    let mut gate = Gate::new(limits, DT, 0, 3.0).unwrap();
    let mut v_x = 20.0;
    for tick in 0..400 {
        v_x += DT * gate.command(tick, v_x, 0.1).u[0] / limits.mass;
        assert!(v_x > -0.2);
    }
    assert!(v_x.abs() < 1e-3);
}

#[test]
fn an_absurd_steering_angle_gets_a_finite_command() {
    for delta in [-1.2e308, 1.2e308, f64::MIN, f64::MAX] {
        let mut gate = Gate::new(limits(0.05), DT, 3, 3.0).unwrap();
        gate.accept(0, &[[0.0, 0.1]]).unwrap();
        assert!(gate.command(0, 10.0, delta).u[1].abs() <= 0.05 * DT);
    }
}

#[test]
fn an_unknown_speed_is_braked() {
    let mut gate = Gate::new(car(), DT, 0, 3.0).unwrap();
    for tick in 0..10 {
        assert_eq!(gate.command(tick, f64::NAN, f64::NAN).mode, Mode::Stop);
    }
    assert_eq!(gate.command(10, f64::NAN, 0.0).u, [-3.0 * car().mass, 0.0]);
}

#[test]
fn a_refused_plan_leaves_the_held_one() {
    let mut gate = Gate::new(car(), DT, 5, 3.0).unwrap();
    gate.accept(4, &[[10.0, 0.0], [20.0, 0.0]]).unwrap();
    assert_eq!(
        gate.accept(5, &[[1.0, 0.0], [1.0, f64::NAN]]),
        Err(GateError::NotFinite(1))
    );
    assert_eq!(
        gate.accept(3, &[[1.0, 0.0]]),
        Err(GateError::Stale { held: 4, got: 3 })
    );
    assert_eq!(gate.accept(5, &[]), Err(GateError::Length(0)));
    let command = gate.command(5, 10.0, 0.0);
    assert_eq!(
        (command.u, command.mode, command.limited),
        ([20.0, 0.0], Mode::Tail, false)
    );
}

#[test]
fn after_a_reset_driving_needs_a_new_plan() {
    let mut gate = Gate::new(car(), DT, 5, 3.0).unwrap();
    assert_eq!(gate.command(0, 10.0, 0.0).mode, Mode::Stop);
    gate.reset();
    assert_eq!(gate.command(1, 10.0, 0.0).mode, Mode::Stop);
    gate.reset();
    gate.accept(2, &[[10.0, 0.0]]).unwrap();
    assert_eq!(gate.command(2, 10.0, 0.0).mode, Mode::Normal);
}

#[test]
fn limits_that_bound_nothing_are_refused() {
    for limits in [
        Limits {
            force_max: f64::NAN,
            ..car()
        },
        Limits {
            force_min: 1.0,
            ..car()
        },
        Limits {
            steering_slew: 0.0,
            ..car()
        },
    ] {
        assert!(matches!(
            Gate::new(limits, DT, 5, 3.0),
            Err(GateError::Limits(_))
        ));
    }
    assert!(Gate::new(car(), DT, 5, 9.0).is_err());
    assert!(Gate::new(car(), 0.0, 5, 3.0).is_err());
}

#[test]
fn the_limits_of_a_vehicle_are_its_accelerations_times_its_mass() {
    let limits = car();
    assert_eq!(limits.mass, 1225.887);
    assert!((limits.force_min + 9807.096).abs() < 1e-9);
    assert!((limits.force_max - 7355.322).abs() < 1e-9);
    assert!((limits.power - 67_056.0189).abs() < 1e-9);
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
    let wide = |name, change: fn(&mut Limits)| {
        let mut limits = car();
        change(&mut limits);
        assert_eq!(at_fault(limits).name, name);
    };
    wide("mass", |limits| limits.mass = 1600.0);
    wide("mass", |limits| limits.mass = 900.0);
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
         narrow the gate, or use a library trained for this vehicle"
    );
}
