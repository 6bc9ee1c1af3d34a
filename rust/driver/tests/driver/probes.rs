//! Replicas that failed: how long they are asked last, and what brings them back.

use std::time::Duration;

use egp_driver::{Driver, Query};
use egp_wire::{Code, Ready};

use crate::world::{
    LISTEN, PERIOD, answered_period, asked, decided, driver, error, ms, name, probed, served,
    solved, tick, without_hedge,
};

/// A driver of two replicas, of which the one that is asked first was silent in the period from 20 to 36 ms; with that
/// query.
fn after_a_failure() -> (Driver, Query) {
    let mut driver = driver(&["a", "b"]);
    tick(&mut driver, ms(20));
    let query = asked(&mut driver);
    driver.wake(ms(36));
    decided(&mut driver);
    (driver, query)
}

/// Opens a period in which the demoted replica must be probed.
fn probing_period(driver: &mut Driver, now: Duration) -> Query {
    tick(driver, now);
    let probe = probed(driver);
    let query = asked(driver);
    assert_ne!(probe.id, query.id);
    driver.replied(now, query.id, &solved(&query).encode(), b"");
    assert!(decided(driver).outcome.is_solved());
    probe
}

#[test]
fn a_replica_is_probed_after_a_second_and_asked_first_again_once_it_answers() {
    let (mut driver, failed) = after_a_failure();
    let second = answered_period(&mut driver, ms(1035));
    assert_ne!(second, failed.replica);
    let probe = probing_period(&mut driver, ms(1036));
    assert_eq!(probe.replica, failed.replica);
    assert_eq!(probe.key, format!("egp/v1/r/{}/ready", failed.replica));
    assert_eq!((probe.payload, probe.listen), (vec![], LISTEN));
    assert!(probe.id > failed.id);
    // The answer comes in time although a period has begun in the meantime.
    assert_eq!(answered_period(&mut driver, ms(1046)), second);
    driver.replied(ms(1056), probe.id, &served().encode(), b"");
    assert_eq!(answered_period(&mut driver, ms(1066)), failed.replica);
}

#[test]
fn of_replicas_that_failed_the_one_that_has_answered_since_is_asked_first() {
    for (at, recovered) in [(ms(56), false), (ms(57), true)] {
        let mut driver = without_hedge(&["a", "b"]);
        let mut silent = |begun| {
            tick(&mut driver, begun);
            let query = asked(&mut driver);
            driver.wake(begun + ms(16));
            decided(&mut driver);
            query
        };
        let (earlier, later) = (silent(ms(20)), silent(ms(40)));
        assert_ne!(earlier.replica, later.replica);
        driver.replied(at, later.id, &solved(&later).encode(), b"");
        tick(&mut driver, ms(60));
        let first = if recovered { later } else { earlier };
        assert_eq!(asked(&mut driver).replica, first.replica);
    }
}

#[test]
fn probes_have_numbers_of_their_own() {
    let (mut driver, _) = after_a_failure();
    tick(&mut driver, ms(1035));
    let before = asked(&mut driver);
    tick(&mut driver, ms(1036));
    let (probe, query) = (probed(&mut driver), asked(&mut driver));
    assert!(before.id < probe.id && probe.id < query.id);
    driver.replied(ms(1037), probe.id, &served().encode(), b"");
    assert!(driver.next_action().is_none(), "a probe decides no period");
    driver.replied(ms(1038), query.id, &solved(&query).encode(), b"");
    assert!(decided(&mut driver).outcome.is_solved());
}

#[test]
fn an_answer_promotes_only_if_it_is_fast_ready_and_of_the_same_library() {
    let ending = Ready {
        ready: false,
        ..served()
    };
    let foreign = Ready {
        library: [8; 32],
        ..served()
    };
    // After a reload the vehicle's library is one of several.
    let reloaded = Ready {
        others: vec![[9; 32], served().library],
        ..foreign.clone()
    };
    let nanosecond = Duration::from_nanos(1);
    for (answer, took, promoted) in [
        (served().encode(), PERIOD, true),
        (served().encode(), PERIOD + nanosecond, false),
        (ending.encode(), ms(1), false),
        (foreign.encode(), ms(1), false),
        (reloaded.encode(), ms(1), true),
        (b"noise".to_vec(), ms(1), false),
    ] {
        let (mut driver, failed) = after_a_failure();
        let probe = probing_period(&mut driver, ms(1036));
        driver.replied(ms(1036) + took, probe.id, &answer, b"");
        let first = answered_period(&mut driver, ms(1060));
        assert_eq!(first == failed.replica, promoted, "{took:?}");
    }
}

#[test]
fn a_probe_that_fails_is_repeated_and_demotes_nobody() {
    let (mut driver, failed) = after_a_failure();
    let probe = probing_period(&mut driver, ms(1036));
    driver.refused(ms(1037), probe.id, &error(Code::Internal));
    let second = answered_period(&mut driver, ms(1235));
    assert_ne!(second, failed.replica);
    let probe = probing_period(&mut driver, ms(1236));
    driver.ended(ms(1237), probe.id);
    driver.replied(ms(1238), probe.id, &served().encode(), b"");
    assert_eq!(answered_period(&mut driver, ms(1240)), second);
    let probe = probing_period(&mut driver, ms(1436));
    assert_eq!(probe.replica, failed.replica);
}

#[test]
fn what_comes_after_the_deadline_does_not_demote_again() {
    type Late = fn(&mut Driver, &Query);
    let answers: [Late; 4] = [
        |driver, query| driver.ended(ms(436), query.id),
        |driver, query| driver.refused(ms(436), query.id, b"Timeout"),
        |driver, query| driver.refused(ms(436), query.id, &error(Code::Internal)),
        |driver, query| driver.replied(ms(436), query.id, b"noise", b""),
    ];
    for answer in answers {
        let (mut driver, failed) = after_a_failure();
        answer(&mut driver, &failed);
        answered_period(&mut driver, ms(1035));
        assert_eq!(
            probing_period(&mut driver, ms(1036)).replica,
            failed.replica
        );
    }
}

#[test]
fn what_comes_after_a_period_that_was_given_up_counts() {
    let mut driver = driver(&["a", "b"]);
    tick(&mut driver, ms(20));
    let given_up = asked(&mut driver);
    tick(&mut driver, ms(30));
    asked(&mut driver);
    driver.ended(ms(31), given_up.id);
    let other = answered_period(&mut driver, ms(40));
    assert_ne!(other, given_up.replica);
    driver.replica_gone(ms(41), &other);
    assert_eq!(answered_period(&mut driver, ms(60)), given_up.replica);
    assert!([name("a"), name("b")].contains(&other));
}
