//! What a driver does with measured states, references and widths that cannot be used, and with a lost vehicle.

use egp_driver::{Action, Driver, Lost, Measurement};
use egp_gate::Mode;
use egp_wire::{MAX_BUDGET_US, Ready};

use crate::world::{
    BUDGET, CAR, HORIZON, PERIOD, answered_period, asked, config, decided, driver, measurement, ms,
    request, served, solved, tick,
};

#[test]
fn a_state_that_cannot_be_used_stops_the_vehicle_and_leaves_a_gap_in_the_history() {
    let mut driver = driver(&["a"]);
    answered_period(&mut driver, ms(20));
    answered_period(&mut driver, ms(40));
    let mut unknown = measurement();
    unknown.x[2] = f64::NAN;
    driver.tick(ms(60), ms(76), unknown).unwrap();
    let step = decided(&mut driver);
    assert_eq!(step.command.mode, Mode::Stop);
    assert_eq!(step.outcome.name(), "invalid_state");
    assert!(step.outcome.detail().starts_with("x: row 0: v_x"));
    assert!(step.command.u.iter().all(|value| value.is_finite()));
    assert_eq!((step.situation, step.replica), (None, None));
    tick(&mut driver, ms(80));
    let request = request(&asked(&mut driver));
    assert_eq!((request.sequence, request.history_z.len()), (4, 0));
    assert_eq!(request.u_prev, step.command.u);
}

#[test]
fn a_state_that_cannot_be_used_stops_the_vehicle_although_its_reference_is_wrong_too() {
    let mut driver = driver(&["a"]);
    answered_period(&mut driver, ms(20));
    let mut unknown = measurement();
    unknown.x[0] = f64::NAN;
    unknown.reference[0][0] = f64::NAN;
    driver.tick(ms(40), ms(56), unknown).unwrap();
    let step = decided(&mut driver);
    assert_eq!(step.command.mode, Mode::Stop);
    assert_eq!(step.outcome.name(), "invalid_state");
}

#[test]
fn a_state_outside_the_domain_of_the_control_step_stops_the_vehicle_without_a_request() {
    let outcome = |component: usize, value: f64| {
        let mut driver = driver(&["a"]);
        answered_period(&mut driver, ms(20));
        let mut measured = measurement();
        measured.x[component] = value;
        driver.tick(ms(40), ms(56), measured).unwrap();
        match driver.next_action() {
            Some(Action::Command(step)) => {
                assert_eq!(step.command.mode, Mode::Stop);
                assert_eq!((step.asked, step.request.len()), (0, 0));
                step.outcome.detail()
            }
            _ => String::new(),
        }
    };
    // Component of the state and its bounds.
    for (component, least, most) in [
        (2, -1.0, 100.0),
        (4, -50.0, 50.0),
        (5, -20.0, 20.0),
        (6, -1.5, 1.5),
    ] {
        assert_eq!(outcome(component, least), "");
        assert_eq!(outcome(component, most), "");
        for value in [least - 0.01, most + 0.01] {
            let detail = outcome(component, value);
            let expected = format!(" = {value} ");
            assert!(detail.contains(&expected), "{component}: {detail}");
            assert!(detail.contains("check unit, sign and frame"), "{detail}");
        }
    }
    assert_eq!(
        outcome(2, -1.5),
        "x: v_x = -1.5 m/s is outside -1 to 100 m/s; check unit, sign and frame"
    );
}

#[test]
fn a_vehicle_that_rolls_back_is_braked_against_its_motion() {
    let mut driver = driver(&["a"]);
    let mut force = f64::NAN;
    for period in 1..=20 {
        let mut measured = measurement();
        measured.x[2] = -1.5;
        let now = PERIOD * period;
        driver.tick(now, now + BUDGET, measured).unwrap();
        force = decided(&mut driver).command.u[0];
    }
    assert_eq!(force, 3.0 * CAR.mass);
}

#[test]
fn a_stop_uses_the_speed_and_the_angle_if_they_can_be_used() {
    let last = |unusable: usize, value: f64, v_x: f64| {
        let mut driver = driver(&["a"]);
        let mut force = f64::NAN;
        for period in 1..=20 {
            let mut unknown = measurement();
            unknown.x[2] = v_x;
            unknown.x[unusable] = value;
            let now = PERIOD * period;
            driver.tick(now, now + BUDGET, unknown).unwrap();
            force = decided(&mut driver).command.u[0];
        }
        force
    };
    let strongest = -3.0 * CAR.mass;
    assert_eq!(last(0, f64::NAN, 12.0), strongest);
    assert_eq!(last(0, f64::NAN, 0.0), 0.0, "it stands");
    for unknown in [f64::NAN, -1e9, 1e300] {
        assert_eq!(last(2, unknown, 0.0), strongest, "{unknown}");
    }
}

#[test]
fn a_budget_is_at_most_what_a_request_may_state() {
    let mut driver = driver(&["a"]);
    driver.tick(ms(20), ms(3_600_000), measurement()).unwrap();
    assert_eq!(request(&asked(&mut driver)).budget_us, MAX_BUDGET_US);
}

#[test]
fn a_lost_vehicle_is_stopped_and_goes_on_asking() {
    let mut driver = driver(&["a"]);
    let mut away = measurement();
    away.x[1] += 26.0;
    for period in 1..=3 {
        let now = PERIOD * period;
        driver.tick(now, now + BUDGET, away.clone()).unwrap();
        let query = asked(&mut driver);
        driver.replied(now, query.id, &solved(&query).encode(), b"");
        let step = decided(&mut driver);
        let lost = (period == 3).then_some(Lost::Distance(26.0, 25.0));
        assert_eq!(step.lost, lost);
        assert_eq!(step.command.mode == Mode::Stop, lost.is_some());
        assert!(step.outcome.is_solved());
    }
    // On its way to a standstill it still counts as lost, also while its state cannot be measured.
    let mut unmeasured = measurement();
    unmeasured.x[2] = f64::NAN;
    for (period, measured) in [(4, measurement()), (5, unmeasured)] {
        let now = PERIOD * period;
        driver.tick(now, now + BUDGET, measured).unwrap();
        if period == 4 {
            let query = asked(&mut driver);
            driver.replied(now, query.id, &solved(&query).encode(), b"");
        }
        assert_eq!(decided(&mut driver).lost, Some(Lost::Distance(26.0, 25.0)));
    }
    driver.reset();
    driver.tick(ms(200), ms(216), measurement()).unwrap();
    let query = asked(&mut driver);
    driver.replied(ms(200), query.id, &solved(&query).encode(), b"");
    assert_eq!(decided(&mut driver).lost, None);
}

#[test]
fn a_period_without_a_usable_reference_ends_a_succession() {
    let mut driver = driver(&["a"]);
    let mut away = measurement();
    away.x[1] += 26.0;
    for period in 1..=6 {
        let now = PERIOD * period;
        let mut measured = away.clone();
        if period % 2 == 0 {
            measured.reference.pop();
        }
        if driver.tick(now, now + BUDGET, measured).is_err() {
            continue;
        }
        let query = asked(&mut driver);
        driver.replied(now, query.id, &solved(&query).encode(), b"");
        assert_eq!(decided(&mut driver).lost, None);
    }
}

#[test]
fn a_reference_or_widths_of_another_length_open_no_period() {
    let mut driver = driver(&["a"]);
    let rows = HORIZON as usize + 1;
    let mut refused = |measurement: Measurement, words: &str| {
        let error = driver.tick(ms(20), ms(36), measurement).unwrap_err();
        assert!(error.to_string().starts_with(words), "{error}");
        assert!(driver.next_action().is_none());
    };
    for wrong in [rows - 1, rows + 1] {
        let mut reference = measurement();
        reference.reference.resize(wrong, [3.96, 4.0, 12.0, 0.0]);
        refused(reference, "reference: expected 5 rows");
        let mut widths = measurement();
        widths.widths = vec![[2.0; 2]; wrong];
        refused(widths, "widths: expected 5 rows");
    }
    let mut fast = measurement();
    fast.reference[1][2] = 1e3;
    refused(fast, "reference: row 1: v_x");
    for v_x in [-1.1, 100.1] {
        let mut other = measurement();
        other.reference[1][2] = v_x;
        refused(
            other,
            &format!("reference: row 1: v_x = {v_x} m/s is outside -1 to 100"),
        );
    }
    let mut wide = measurement();
    wide.widths = vec![[2.0; 2]; rows];
    wide.widths[3][1] = 1001.0;
    refused(wide, "widths: row 3: [2, 1001] m is beyond");
    let mut fitting = measurement();
    fitting.widths = vec![[2.0; 2]; rows];
    driver.tick(ms(20), ms(36), fitting).unwrap();
    assert_eq!(request(&asked(&mut driver)).widths.len(), rows);
}

#[test]
fn a_period_without_a_request_counts_and_leaves_a_gap_in_the_history() {
    let mut driver = driver(&["a"]);
    answered_period(&mut driver, ms(20));
    answered_period(&mut driver, ms(40));
    tick(&mut driver, ms(60));
    let open = asked(&mut driver);
    let mut short = measurement();
    short.reference.pop();
    driver.tick(ms(80), ms(96), short).unwrap_err();
    // The period before is given up, so that its deadline decides nothing.
    driver.wake(ms(96));
    assert!(driver.next_action().is_none());
    driver.replied(ms(97), open.id, &solved(&open).encode(), b"");
    tick(&mut driver, ms(100));
    let request = request(&asked(&mut driver));
    assert_eq!((request.sequence, request.history_z.len()), (5, 0));
    assert_eq!(request.plan_shift, 2);
}

#[test]
fn a_yaw_must_point_along_the_reference_where_its_points_are_apart() {
    let mut driver = driver(&["a"]);
    let mut accepted = |spacing: [f64; 2], psi: f64| {
        let row = |t: u32| {
            let t = f64::from(t);
            [3.0 + spacing[0] * t, 4.0 + spacing[1] * t, 12.0, psi]
        };
        let measurement = Measurement {
            reference: (0..=HORIZON).map(row).collect(),
            ..measurement()
        };
        driver.tick(ms(20), ms(36), measurement).is_ok()
    };
    assert!(accepted([0.25, 0.0], -0.5), "the largest deviation");
    assert!(!accepted([0.25, 0.0], -0.5 - 1e-9));
    assert!(!accepted([0.25, 0.0], 0.6));
    assert!(accepted([0.0, 0.25], std::f64::consts::FRAC_PI_2));
    assert!(!accepted([0.0, 0.25], 0.0));
    assert!(accepted([0.0, -0.25], -std::f64::consts::FRAC_PI_2));
    assert!(accepted([-0.25, 0.0], std::f64::consts::PI));
    assert!(!accepted([0.0625, 0.0], 3.0));
    assert!(
        accepted([0.03125, 0.0], 3.0),
        "too close to have a direction"
    );
}

#[test]
fn points_exactly_5_cm_apart_have_no_direction() {
    let mut driver = driver(&["a"]);
    let mut to_and_fro = measurement();
    for (t, row) in to_and_fro.reference.iter_mut().enumerate() {
        let p_x = if t % 2 == 0 { 0.0 } else { 0.05 };
        *row = [p_x, 0.0, 12.0, std::f64::consts::FRAC_PI_2];
    }
    driver.tick(ms(20), ms(36), to_and_fro).unwrap();
    asked(&mut driver);
}

#[test]
fn speeds_in_another_unit_than_the_positions_are_an_error() {
    const LONG: u32 = 50; // a horizon of 1 s
    let long = || Ready {
        horizon: LONG,
        ..served()
    };
    let tick = |spacing: f64, v_x: f64| {
        let mut driver = Driver::new(config(), long()).unwrap();
        let row = |t: u32| [3.0 + spacing * f64::from(t), 4.0, v_x, 0.0];
        let reference = (0..=LONG).map(row).collect();
        let measured = Measurement {
            reference,
            ..measurement()
        };
        driver.tick(ms(20), ms(36), measured)
    };
    let error = tick(0.3, 54.0).unwrap_err().to_string();
    assert_eq!(
        error,
        "reference: the positions of all rows are 15.0 m apart in total, and the speeds v_x cover 54.0 m in the same time; v_x \
         is measured in m/s (1 m/s is 3.6 km/h), and rows are 0.02 s apart"
    );
    assert!(tick(1.5, 15.0).is_err(), "rows that are 0.1 s apart");
    // A planner's path that ends within the horizon.
    let mut ended = measurement();
    ended.reference = (0..=LONG)
        .map(|t| [3.0 + 0.3 * f64::from(t.min(8)), 4.0, 15.0, 0.0])
        .collect();
    let mut driver = Driver::new(config(), long()).unwrap();
    assert_eq!(driver.tick(ms(20), ms(36), ended), Ok(()));
    // Positions at another speed than the stated one, and vehicles that start or stand.
    for (spacing, v_x) in [
        (0.3, 15.0),
        (0.3, 44.0),
        (0.3, 5.5),
        (0.04, 54.0),
        (0.0, 54.0),
        (0.3, 0.0),
    ] {
        assert_eq!(tick(spacing, v_x), Ok(()), "{spacing} {v_x}");
    }
}
