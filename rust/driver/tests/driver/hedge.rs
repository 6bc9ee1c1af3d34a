//! Periods in which a second replica is asked while the first one may still answer.

use std::time::Duration;

use egp_driver::{Driver, DriverConfig, DriverError, Outcome};
use egp_gate::Mode;
use egp_wire::Code;
use egp_wire::keys::Name;

use crate::world::{
    BUDGET, PERIOD, answered_period, appear, asked, config, decided, driver, error, measurement,
    ms, served, solved, tick, without_hedge,
};

/// Half of the time that an answer may take.
const HEDGE: Duration = Duration::from_millis(8);

/// The vehicle's order of two replicas.
fn order(driver: &mut Driver, replicas: &[&str]) -> [Name; 2] {
    let first = answered_period(driver, ms(20));
    let second = replicas.iter().find(|name| **name != first.as_str());
    [first, second.unwrap().parse().unwrap()]
}

#[test]
fn a_silent_replica_costs_no_period_if_another_one_answers() {
    let mut driver = driver(&["a", "b"]);
    let [first, second] = order(&mut driver, &["a", "b"]);
    tick(&mut driver, ms(40));
    let silent = asked(&mut driver);
    assert_eq!(silent.replica, first);
    assert_eq!(driver.next_wake(), Some(ms(40) + HEDGE));
    driver.wake(ms(47) + Duration::from_nanos(999_999));
    assert!(driver.next_action().is_none());
    driver.wake(ms(48));
    let hedge = asked(&mut driver);
    assert_eq!(hedge.replica, second);
    assert_eq!(hedge.payload, silent.payload);
    assert_eq!(driver.next_wake(), Some(ms(40) + BUDGET));
    driver.replied(ms(50), hedge.id, &solved(&hedge).encode(), b"");
    let step = decided(&mut driver);
    assert!(step.outcome.is_solved());
    assert_eq!((step.command.mode, step.asked), (Mode::Normal, 2));
    assert_eq!(
        (step.replica, step.latency),
        (Some(second.clone()), Some(ms(10)))
    );
    // The deadline has passed without an answer of the first one, which is asked last from now on.
    assert_eq!(answered_period(&mut driver, ms(60)), second);
    tick(&mut driver, ms(80));
    let query = asked(&mut driver);
    driver.ended(ms(81), query.id);
    assert_eq!(asked(&mut driver).replica, first);
}

#[test]
fn the_first_answer_counts_and_the_other_one_is_neither_late_nor_a_failure() {
    for answers_first in [0, 1] {
        let mut driver = driver(&["a", "b"]);
        let [first, _] = order(&mut driver, &["a", "b"]);
        tick(&mut driver, ms(40));
        let slow = asked(&mut driver);
        driver.wake(ms(48));
        let hedge = asked(&mut driver);
        let queries = [&slow, &hedge];
        let (used, other) = (queries[answers_first], queries[1 - answers_first]);
        driver.replied(ms(49), used.id, &solved(used).encode(), b"");
        let step = decided(&mut driver);
        assert_eq!(step.replica.as_ref(), Some(&used.replica));
        driver.replied(ms(50), other.id, &solved(other).encode(), b"");
        assert!(driver.next_action().is_none());
        tick(&mut driver, ms(60));
        let query = asked(&mut driver);
        assert_eq!(query.replica, first, "both have answered in time");
        driver.replied(ms(61), query.id, &solved(&query).encode(), b"");
        assert!(decided(&mut driver).late.is_empty());
    }
}

#[test]
fn an_answer_after_the_deadline_that_nobody_waits_for_is_a_failure() {
    let mut driver = driver(&["a", "b"]);
    let [first, second] = order(&mut driver, &["a", "b"]);
    tick(&mut driver, ms(40));
    let slow = asked(&mut driver);
    driver.wake(ms(48));
    let hedge = asked(&mut driver);
    driver.replied(ms(49), hedge.id, &solved(&hedge).encode(), b"");
    decided(&mut driver);
    driver.replied(ms(57), slow.id, &solved(&slow).encode(), b"");
    assert_eq!(slow.replica, first);
    assert_eq!(answered_period(&mut driver, ms(60)), second);
}

#[test]
fn a_period_reports_the_replica_that_failed_last() {
    let mut driver = driver(&["a", "b"]);
    tick(&mut driver, ms(40));
    let slow = asked(&mut driver);
    driver.wake(ms(48));
    let hedge = asked(&mut driver);
    driver.ended(ms(49), hedge.id);
    driver.refused(ms(50), slow.id, &error(Code::Overloaded));
    let step = decided(&mut driver);
    assert!(matches!(step.outcome, Outcome::Refused(_)));
    assert_eq!(step.replica, Some(slow.replica));

    tick(&mut driver, ms(60));
    let refusing = asked(&mut driver);
    driver.refused(ms(61), refusing.id, &error(Code::Overloaded));
    let last = asked(&mut driver);
    driver.replica_gone(ms(62), &last.replica);
    let step = decided(&mut driver);
    assert_eq!(step.outcome, Outcome::Unreachable);
    assert_eq!(step.replica, Some(last.replica.clone()));

    appear(&mut driver, &last.replica);
    tick(&mut driver, ms(80));
    let silent = asked(&mut driver);
    driver.wake(ms(88));
    let hedge = asked(&mut driver);
    driver.refused(ms(90), hedge.id, &error(Code::Overloaded));
    driver.wake(ms(96));
    let step = decided(&mut driver);
    assert_eq!(step.outcome, Outcome::Late);
    assert_eq!(step.replica, Some(silent.replica));
}

#[test]
fn a_failed_second_question_leads_to_the_third_replica_and_then_to_the_deadline() {
    let mut driver = driver(&["a", "b", "c"]);
    tick(&mut driver, ms(40));
    let silent = asked(&mut driver);
    driver.wake(ms(48));
    let second = asked(&mut driver);
    driver.refused(ms(49), second.id, &error(Code::Overloaded));
    let third = asked(&mut driver);
    assert!(third.replica != silent.replica && third.replica != second.replica);
    driver.ended(ms(50), third.id);
    assert!(driver.next_action().is_none(), "the first one may answer");
    let mut late = driver.clone();
    driver.replied(ms(55), silent.id, &solved(&silent).encode(), b"");
    let step = decided(&mut driver);
    assert!(step.outcome.is_solved());
    assert_eq!((step.asked, step.replica), (3, Some(silent.replica)));

    late.wake(ms(56));
    let step = decided(&mut late);
    assert_eq!((step.outcome, step.asked), (Outcome::Late, 3));
}

#[test]
fn a_failed_first_question_leaves_the_second_one_to_decide() {
    for way in ["refused", "ended", "gone"] {
        let mut driver = driver(&["a", "b"]);
        tick(&mut driver, ms(40));
        let first = asked(&mut driver);
        driver.wake(ms(48));
        let second = asked(&mut driver);
        match way {
            "refused" => driver.refused(ms(49), first.id, &error(Code::TooLate)),
            "ended" => driver.ended(ms(49), first.id),
            _ => driver.replica_gone(ms(49), &first.replica),
        }
        assert!(driver.next_action().is_none(), "{way}");
        driver.replied(ms(50), second.id, &solved(&second).encode(), b"");
        assert!(decided(&mut driver).outcome.is_solved(), "{way}");
    }
}

#[test]
fn both_replicas_that_let_the_deadline_pass_are_demoted() {
    let mut driver = driver(&["a", "b", "c"]);
    tick(&mut driver, ms(40));
    let silent = asked(&mut driver);
    driver.wake(ms(48));
    let hedge = asked(&mut driver);
    driver.wake(ms(56));
    assert_eq!(decided(&mut driver).outcome, Outcome::Late);
    let next = answered_period(&mut driver, ms(60));
    assert!(next != silent.replica && next != hedge.replica);
}

#[test]
fn at_most_one_period_in_twenty_asks_twice_in_the_long_run() {
    let mut driver = driver(&["a", "b"]);
    let mut hedges = 0;
    for period in 1..=1000 {
        let now = PERIOD * period;
        tick(&mut driver, now);
        let query = asked(&mut driver);
        driver.wake(now + HEDGE);
        if period <= 3 {
            assert_eq!(driver.next_wake(), Some(now + BUDGET), "{period}");
        }
        if let Some(egp_driver::Action::Ask(_)) = driver.next_action() {
            hedges += 1;
        }
        // Both are slow and answer in time.
        driver.replied(now + BUDGET, query.id, &solved(&query).encode(), b"");
        assert!(decided(&mut driver).outcome.is_solved());
    }
    assert!((51..=53).contains(&hedges), "{hedges}");
}

#[test]
fn a_second_question_can_be_switched_off_and_is_not_asked_without_a_second_replica() {
    for mut driver in [without_hedge(&["a", "b"]), driver(&["a"])] {
        tick(&mut driver, ms(40));
        asked(&mut driver);
        assert_eq!(driver.next_wake(), Some(ms(40) + BUDGET));
        driver.wake(ms(55));
        assert!(driver.next_action().is_none());
    }
    for hedge in [0.0, -0.5, 1.0 + 1e-9, f64::INFINITY] {
        let config = DriverConfig { hedge, ..config() };
        let error = Driver::new(config, served()).unwrap_err();
        assert_eq!(error, DriverError::Hedge(hedge));
    }
}

#[test]
fn times_that_a_duration_cannot_hold_do_not_end_the_program() {
    let end = Duration::MAX;
    for now in [Duration::ZERO, end.saturating_sub(ms(1)), end] {
        for mut driver in [driver(&["a", "b"]), without_hedge(&["a", "b"])] {
            driver.tick(now, end, measurement()).unwrap();
            driver.wake(end);
            let mut actions = std::iter::from_fn(|| driver.next_action());
            assert!(actions.any(|action| matches!(action, egp_driver::Action::Command(_))));
        }
    }
}
