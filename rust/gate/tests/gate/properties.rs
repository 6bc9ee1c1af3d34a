//! Commands respect the limits for every input.
#![allow(clippy::unwrap_used, clippy::semicolon_if_nothing_returned)]

use egp_gate::{Gate, GateError, Limits, MAX_HORIZON, Mode};
use proptest::prelude::*;

pub(crate) const DT: f64 = 0.05;

/// A car of 1200 kg.
pub(crate) const LIMITS: Limits = Limits {
    mass: 1200.0,
    force_min: -9600.0,
    force_max: 7200.0,
    power: 66_000.0,
    force_slew: 72_000.0,
    steering_angle: 0.9,
    steering_rate: 0.4,
    steering_slew: 8.0,
};

/// Limits with a slow steering slew, for which the look-ahead spans several periods.
fn limits(steering_slew: f64) -> Limits {
    Limits {
        steering_slew,
        ..LIMITS
    }
}

/// The angle by which the wheels turn on from the rate `rate`, slowed by the slew limit in each period.
fn turned_while_slowing(rate: f64, steering_slew: f64) -> f64 {
    let rates = std::iter::successors(Some(rate), |rate| Some(rate - steering_slew * DT));
    DT * rates.take_while(|rate| *rate > 0.0).sum::<f64>()
}

/// The largest rate after which the wheels can stop within `room` \[rad\], by bisection.
fn largest_safe_rate(room: f64, steering_slew: f64) -> f64 {
    let (mut safe, mut unsafe_rate) = (0.0, LIMITS.steering_rate + 1e-9);
    for _ in 0..60 {
        let middle = 0.5 * (safe + unsafe_rate);
        if turned_while_slowing(middle, steering_slew) <= room {
            safe = middle;
        } else {
            unsafe_rate = middle;
        }
    }
    safe
}

/// Any double; NaN and infinities are frequent.
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
    fn whatever_the_limits_wheels_beyond_one_return_at_the_rate_of_the_other_side(
        steering_angle in 0.01..1.5,
        steering_rate in 0.05..5.0,
        steering_slew in 0.02..50.0,
        delta in 0.0..2.0,
    ) {
        let limits = Limits { steering_angle, steering_rate, steering_slew, ..LIMITS };
        let rate_at = |delta: f64| {
            let mut gate = Gate::new(limits, DT, 3, 3.0).unwrap();
            (0..1000).map(|tick| gate.command(tick, 10.0, delta).u[1]).last().unwrap()
        };
        let (left, right) = (rate_at(delta), rate_at(-delta));
        prop_assert_eq!(left, -right);
        prop_assert!(left.abs() <= steering_rate);
        prop_assert_eq!(left < 0.0, delta > steering_angle);
    }

    #[test]
    fn the_steering_angle_stays_inside_its_limit(
        wanted in prop::collection::vec(-1.0..1.0, 1..200),
        steering_slew in 0.05..10.0,
        start in -0.9..0.9,
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

    /// The gate holds the wheels back no more than the limits need, in either direction.
    #[test]
    fn the_wheels_turn_as_fast_as_the_limits_allow(
        side in prop_oneof![Just(1.0), Just(-1.0)],
        steering_slew in 0.2..10.0,
        start in 0.0..0.9,
    ) {
        let limits = limits(steering_slew);
        let mut gate = Gate::new(limits, DT, 0, 3.0).unwrap();
        let (mut delta, mut previous): (f64, f64) = (start, 0.0);
        for tick in 0..60 {
            gate.accept(tick, &[[0.0, side]]).unwrap();
            let rate = side * gate.command(tick, 10.0, side * delta).u[1];
            let safe = largest_safe_rate(limits.steering_angle - delta, steering_slew);
            let reachable = (previous + steering_slew * DT).min(limits.steering_rate);
            let expected = safe.min(reachable).max(previous - steering_slew * DT);
            prop_assert!((rate - expected).abs() < 1e-7, "{rate} instead of {expected}");
            (delta, previous) = (delta + DT * rate, rate);
        }
    }

    /// Beyond their limit the wheels are led back, in one period if the rate allows that.
    #[test]
    fn wheels_beyond_their_limit_are_led_back(
        side in prop_oneof![Just(1.0), Just(-1.0)],
        beyond in 0.0..0.1,
        wanted in 0.0..1.0,
    ) {
        let mut gate = Gate::new(LIMITS, DT, 0, 3.0).unwrap();
        gate.accept(0, &[[0.0, side * wanted]]).unwrap();
        let command = gate.command(0, 10.0, side * (LIMITS.steering_angle + beyond));
        let back = f64::min(beyond / DT, LIMITS.steering_rate);
        prop_assert!((command.u[1] + side * back).abs() < 1e-9);
    }

    /// Below 0.5 m/s the stopping force is proportional to the speed, so that a stop ends in standstill.
    #[test]
    fn the_stopping_force_fades_with_the_speed(v_x in -0.5..0.5) {
        let mut gate = Gate::new(LIMITS, DT, 0, 1.0).unwrap();
        let command = gate.command(0, v_x, 0.0);
        prop_assert!((command.u[0] + LIMITS.mass * v_x / 0.5).abs() < 1e-9);
    }

    /// A command inside all limits leaves the gate as it was planned.
    #[test]
    fn a_command_inside_the_limits_is_not_changed(
        force in -3600.0..3600.0,
        rate in -0.4..0.4,
        v_x in 0.0..9.0,
        delta in -0.8..0.8,
    ) {
        let mut gate = Gate::new(LIMITS, DT, 0, 3.0).unwrap();
        gate.accept(0, &[[force, rate]]).unwrap();
        let command = gate.command(0, v_x, delta);
        prop_assert_eq!((command.u, command.limited), ([force, rate], false));
    }

    #[test]
    fn without_new_plans_the_tail_ends_in_a_stop(length in 1_usize..20, max_tail in 0_u64..20) {
        let mut gate = Gate::new(LIMITS, DT, max_tail, 3.0).unwrap();
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
    let mut gate = Gate::new(LIMITS, DT, 0, 3.0).unwrap();
    let mut v_x = 20.0;
    for tick in 0..400 {
        v_x += DT * gate.command(tick, v_x, 0.1).u[0] / LIMITS.mass;
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
    let mut gate = Gate::new(LIMITS, DT, 0, 3.0).unwrap();
    for tick in 0..10 {
        assert_eq!(gate.command(tick, f64::NAN, f64::NAN).mode, Mode::Stop);
    }
    assert_eq!(gate.command(10, f64::NAN, 0.0).u, [-3.0 * LIMITS.mass, 0.0]);
}

#[test]
fn a_stop_without_a_measured_speed_brakes_whatever_the_speed_was_before() {
    for before in [-0.5, -0.1, 0.0, 0.3, 20.0] {
        let mut gate = Gate::new(LIMITS, DT, 5, 3.0).unwrap();
        gate.command(0, before, 0.0);
        for tick in 1..10 {
            assert!(gate.command(tick, f64::NAN, 0.0).u[0] <= 0.0, "{before}");
        }
        let braked = gate.command(10, f64::NAN, 0.0);
        assert_eq!(braked.u, [-3.0 * LIMITS.mass, 0.0], "{before}");
        // A speed that is measured again counts again.
        for tick in 11..20 {
            gate.command(tick, 0.0, 0.0);
        }
        assert_eq!(gate.command(20, 0.0, 0.0).u, [0.0, 0.0], "{before}");
    }
}

#[test]
fn an_invalid_plan_does_not_replace_the_stored_one() {
    let mut gate = Gate::new(LIMITS, DT, 5, 3.0).unwrap();
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
fn a_period_is_from_a_tenth_of_a_millisecond_to_ten_seconds() {
    for dt in [1e-4, 10.0] {
        assert!(Gate::new(LIMITS, dt, 5, 3.0).is_ok());
    }
    for dt in [0.0, 1e-160, 9e-5, 11.0, f64::INFINITY, f64::NAN] {
        let error = Gate::new(LIMITS, dt, 5, 3.0).unwrap_err();
        assert!(matches!(error, GateError::Period(_)), "{error}");
    }
}

#[test]
fn a_plan_may_be_as_long_as_the_gate_can_hold() {
    let mut gate = Gate::new(LIMITS, DT, MAX_HORIZON as u64, 3.0).unwrap();
    let plan = [[10.0, 0.0]; MAX_HORIZON + 1];
    assert_eq!(
        gate.accept(0, &plan),
        Err(GateError::Length(MAX_HORIZON + 1))
    );
    gate.accept(0, &plan[1..]).unwrap();
    let last = MAX_HORIZON as u64 - 1;
    assert_eq!(gate.command(last, 10.0, 0.0).mode, Mode::Tail);
    assert_eq!(gate.command(last + 1, 10.0, 0.0).mode, Mode::Stop);
}

#[test]
fn a_second_plan_for_the_same_period_replaces_the_first() {
    let mut gate = Gate::new(LIMITS, DT, 5, 3.0).unwrap();
    gate.accept(4, &[[10.0, 0.0]]).unwrap();
    gate.accept(4, &[[20.0, 0.0]]).unwrap();
    assert_eq!(gate.command(4, 10.0, 0.0).u, [20.0, 0.0]);
}

#[test]
fn after_a_reset_periods_may_be_counted_anew() {
    let mut gate = Gate::new(LIMITS, DT, 5, 3.0).unwrap();
    gate.accept(1000, &[[10.0, 0.0]]).unwrap();
    gate.reset();
    gate.accept(0, &[[20.0, 0.0]]).unwrap();
    assert_eq!(gate.command(0, 10.0, 0.0).u, [20.0, 0.0]);
}

#[test]
fn a_stop_by_request_is_latched_whatever_plan_is_held() {
    let mut gate = Gate::new(LIMITS, DT, 5, 3.0).unwrap();
    gate.accept(0, &[[10.0, 0.1]; 5]).unwrap();
    gate.stop();
    for tick in 0..3 {
        let command = gate.command(tick, 10.0, 0.0);
        assert_eq!((command.mode, command.u[1]), (Mode::Stop, 0.0));
        assert_eq!(gate.accept(tick, &[[0.0, 0.0]; 5]), Err(GateError::Stopped));
    }
    gate.reset();
    gate.accept(3, &[[10.0, 0.0]]).unwrap();
    assert_eq!(gate.command(3, 10.0, 0.0).mode, Mode::Normal);
}

#[test]
fn invalid_limits_are_errors_that_name_the_field() {
    type Spoil = fn(&mut Limits, f64);
    let spoils: [(&str, Spoil); 8] = [
        ("mass", |limits, value| limits.mass = value),
        ("-force_min", |limits, value| limits.force_min = -value),
        ("force_max", |limits, value| limits.force_max = value),
        ("power", |limits, value| limits.power = value),
        ("force_slew", |limits, value| limits.force_slew = value),
        ("steering_angle", |limits, value| {
            limits.steering_angle = value
        }),
        ("steering_rate", |limits, value| {
            limits.steering_rate = value
        }),
        ("steering_slew", |limits, value| {
            limits.steering_slew = value
        }),
    ];
    for (name, spoil) in spoils {
        for value in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut limits = LIMITS;
            spoil(&mut limits, value);
            let refused = Gate::new(limits, DT, 5, 3.0).unwrap_err();
            assert!(
                matches!(refused, GateError::Limits(error) if error.name == name),
                "{name} = {value}: {refused}"
            );
        }
    }
    assert!(Gate::new(LIMITS, DT, 5, 9.0).is_err());
    assert!(Gate::new(LIMITS, 0.0, 5, 3.0).is_err());
}
