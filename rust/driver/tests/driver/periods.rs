//! Control periods from their question to their command.

use std::time::Duration;

use egp_driver::Outcome;
use egp_gate::Mode;
use egp_wire::{Code, Status, Timing};
use prost::Message as _;

use crate::world::{
    BUDGET, HORIZON, LISTEN, answered_period, appear, asked, decided, driver, error, infeasible,
    measurement, ms, name, request, served, solved, tick, without_hedge,
};

#[test]
fn a_reply_in_time_becomes_the_command() {
    let mut driver = driver(&["a"]);
    assert_eq!((driver.served(), driver.budget()), (&served(), BUDGET));
    assert_eq!((driver.mode(), driver.next_wake()), (Mode::Waiting, None));
    tick(&mut driver, ms(20));
    assert_eq!(driver.next_wake(), Some(ms(20) + BUDGET));
    let query = asked(&mut driver);
    assert_eq!(query.replica, name("a"));
    assert_eq!(query.key, "egp/v1/r/a/depot/car-7/step");
    assert_eq!(query.listen, BUDGET + LISTEN);
    assert_eq!(request(&query).budget_us, 16_000);
    assert!(driver.next_action().is_none());

    let timing = Timing {
        queue_us: 1,
        step_us: 2,
        ..Timing::default()
    };
    let reply = solved(&query);
    driver.replied(ms(25), query.id, &reply.encode(), &timing.encode_to_vec());
    let step = decided(&mut driver);
    assert_eq!(step.command.mode, Mode::Normal);
    assert_eq!(step.command.u, [100.0, 0.0]);
    assert_eq!(step.outcome, Outcome::Replied(Status::Solved));
    assert!(step.outcome.is_solved());
    assert_eq!(step.replica, Some(name("a")));
    assert_eq!(step.request, query.payload);
    assert_eq!(step.reply_bytes, reply.encode());
    assert_eq!(step.reply, Some(reply));
    assert_eq!(step.latency, Some(ms(5)));
    assert_eq!(step.timing, Some(timing));
    assert_eq!((step.asked, step.late.len()), (1, 0));
    assert_eq!(step.lost, None);
    assert_eq!(step.situation.unwrap().distance, 0.0);
    assert_eq!(driver.weights(), [0.25, 0.75]);
    assert_eq!((driver.mode(), driver.next_wake()), (Mode::Normal, None));

    tick(&mut driver, ms(40));
    let next = request(&asked(&mut driver));
    assert_eq!((next.sequence, next.u_prev), (2, [100.0, 0.0]));
    assert_eq!(next.weights, [0.25, 0.75]);
}

#[test]
fn an_attachment_is_no_part_of_the_reply() {
    for (attachment, expected) in [(&b""[..], None), (&[0xff; 9][..], None)] {
        let mut driver = driver(&["a"]);
        tick(&mut driver, ms(20));
        let query = asked(&mut driver);
        driver.replied(ms(21), query.id, &solved(&query).encode(), attachment);
        let step = decided(&mut driver);
        assert!(step.outcome.is_solved());
        assert_eq!(step.timing, expected);
    }
}

#[test]
fn a_silent_replica_is_waited_for_until_the_deadline_and_then_asked_last() {
    let mut driver = without_hedge(&["a", "b"]);
    let first = answered_period(&mut driver, ms(20));
    tick(&mut driver, ms(40));
    let query = asked(&mut driver);
    assert_eq!(query.replica, first);
    driver.wake(ms(55) + Duration::from_nanos(999_999));
    assert!(driver.next_action().is_none());
    driver.wake(ms(56));
    let step = decided(&mut driver);
    assert_eq!(step.outcome, Outcome::Late);
    assert_eq!(step.outcome.name(), "late");
    assert_eq!(step.command.mode, Mode::Tail);
    assert_eq!((step.latency, step.asked), (None, 1));
    assert_eq!(step.replica, Some(first.clone()));
    driver.wake(ms(57)); // No period is open.
    assert!(driver.next_action().is_none());
    assert_ne!(answered_period(&mut driver, ms(60)), first);
}

#[test]
fn a_reply_counts_until_the_deadline_and_brings_the_tail_afterwards() {
    let mut driver = driver(&["a"]);
    tick(&mut driver, ms(20));
    let query = asked(&mut driver);
    driver.replied(ms(36), query.id, &solved(&query).encode(), b"");
    assert!(decided(&mut driver).outcome.is_solved());

    tick(&mut driver, ms(40));
    let query = asked(&mut driver);
    let reply = solved(&query).encode();
    driver.replied(ms(56) + Duration::from_nanos(1), query.id, &reply, b"");
    assert!(driver.next_action().is_none(), "the deadline has passed");
    driver.wake(ms(57));
    let step = decided(&mut driver);
    assert_eq!(step.late.len(), 1);
    assert_eq!(step.late[0].latency, ms(16) + Duration::from_nanos(1));
    assert_eq!(step.late[0].reply_bytes, reply);
    assert_eq!(
        step.command.mode,
        Mode::Normal,
        "the gate has the plan already"
    );
}

#[test]
fn a_reply_to_an_earlier_period_does_not_decide_the_open_one() {
    let mut driver = driver(&["a"]);
    tick(&mut driver, ms(20));
    let first = asked(&mut driver);
    driver.wake(ms(36));
    assert_eq!(decided(&mut driver).command.mode, Mode::Waiting);
    tick(&mut driver, ms(40));
    let second = asked(&mut driver);
    driver.replied(ms(41), first.id, &solved(&first).encode(), b"");
    assert!(driver.next_action().is_none());
    driver.replied(ms(42), second.id, &solved(&second).encode(), b"");
    let step = decided(&mut driver);
    assert_eq!(step.command.mode, Mode::Normal);
    assert_eq!(step.late.len(), 1);
    driver.replied(ms(43), second.id, &solved(&second).encode(), b"");
    assert!(
        driver.next_action().is_none(),
        "a second reply to one query"
    );
}

#[test]
fn an_older_plan_is_not_used_after_a_newer_reply_without_one() {
    let mut driver = driver(&["a"]);
    answered_period(&mut driver, ms(20));
    tick(&mut driver, ms(40));
    let older = asked(&mut driver);
    driver.wake(ms(56));
    decided(&mut driver);
    tick(&mut driver, ms(60));
    let newer = asked(&mut driver);
    driver.replied(ms(61), newer.id, &infeasible(&newer).encode(), b"");
    let step = decided(&mut driver);
    assert_eq!(step.outcome.name(), "infeasible");
    assert_eq!(
        step.outcome.detail(),
        "the solver found no plan: infeasible"
    );
    assert_eq!(step.command.mode, Mode::Tail);
    let mut late = solved(&older);
    late.plan_u = vec![[-500.0, 0.0]; HORIZON as usize];
    driver.replied(ms(62), older.id, &late.encode(), b"");
    tick(&mut driver, ms(80));
    driver.wake(ms(96));
    asked(&mut driver);
    let step = decided(&mut driver);
    assert_eq!((step.command.mode, step.late.len()), (Mode::Tail, 1));
    assert_eq!(step.command.u, [100.0, 0.0], "that of the first plan");
}

#[test]
fn the_next_replica_is_asked_after_any_answer_that_brings_no_plan() {
    for (way, demoted) in [
        ("overloaded", false),
        ("too late", false),
        ("draining", false),
        ("superseded", false),
        ("invalid field", false),
        ("internal", true),
        ("noise in an error", true),
        ("noise", true),
        ("ended", true),
        ("gone", false),
    ] {
        let mut driver = driver(&["a", "b"]);
        tick(&mut driver, ms(20));
        let query = asked(&mut driver);
        let (now, id) = (ms(21), query.id);
        match way {
            "overloaded" => driver.refused(now, id, &error(Code::Overloaded)),
            "too late" => driver.refused(now, id, &error(Code::TooLate)),
            "draining" => driver.refused(now, id, &error(Code::Draining)),
            "superseded" => {
                driver.refused(now, id, &error(Code::Superseded));
                driver.ended(now, id);
            }
            "invalid field" => driver.refused(now, id, &error(Code::InvalidField)),
            "internal" => driver.refused(now, id, &error(Code::Internal)),
            "noise in an error" => driver.refused(now, id, &[0xff; 9]),
            "noise" => driver.replied(now, id, &[0xff; 9], b""),
            "gone" => driver.replica_gone(now, &query.replica),
            _ => driver.ended(now, id),
        }
        let next = asked(&mut driver);
        assert_ne!((&next.replica, next.id), (&query.replica, query.id));
        assert_eq!(next.listen, ms(15) + LISTEN);
        driver.replied(ms(22), next.id, &solved(&next).encode(), b"");
        let step = decided(&mut driver);
        assert_eq!((step.asked, step.latency), (2, Some(ms(2))), "{way}");
        if way == "gone" {
            appear(&mut driver, &query.replica);
        }
        let first = answered_period(&mut driver, ms(40));
        assert_eq!(first != query.replica, demoted, "{way}");
    }
}

#[test]
fn the_last_answer_is_the_outcome_when_nobody_is_left() {
    let outcome = |act: &dyn Fn(&mut egp_driver::Driver, egp_driver::QueryId)| {
        let mut driver = driver(&["a"]);
        tick(&mut driver, ms(20));
        let query = asked(&mut driver);
        act(&mut driver, query.id);
        let step = decided(&mut driver);
        assert_eq!(step.command.mode, Mode::Waiting);
        step.outcome
    };
    let refused = outcome(&|driver, id| driver.refused(ms(21), id, &error(Code::Overloaded)));
    assert_eq!(
        (refused.name(), refused.detail()),
        ("refused", "overloaded: no".to_owned())
    );
    let unusable = outcome(&|driver, id| driver.replied(ms(21), id, b"noise", b""));
    assert_eq!(unusable.name(), "unusable");
    let detail = unusable.detail();
    assert!(detail.starts_with("the reply cannot be used: "), "{detail}");
    let ended = outcome(&|driver, id| driver.ended(ms(21), id));
    assert_eq!(ended, Outcome::Unreachable);
    assert_eq!(
        (ended.name(), ended.detail()),
        (
            "unreachable",
            "no replica of the service can be reached that fits: none announces itself, or those that do shut down, serve \
             another library or vehicle or have another horizon, or access control does not admit this vehicle's certificate"
                .to_owned()
        )
    );
    let late = outcome(&|driver, _| driver.wake(ms(36)));
    assert_eq!(late.detail(), "no answer came before the deadline");
    let solved = outcome_names();
    assert_eq!(
        solved,
        [
            "unspecified",
            "solved",
            "iteration_limit",
            "infeasible",
            "numerical_error",
            "check_failed"
        ]
    );
    assert_eq!(Outcome::Replied(Status::Solved).detail(), "");
    let inaccurate = Outcome::Replied(Status::CheckFailed);
    assert!(!inaccurate.is_solved());
    let detail = inaccurate.detail();
    assert!(
        detail.starts_with("the solver found no plan that passes its check (check_failed)")
            && detail.contains("usually a weight or a penalty"),
        "{detail}"
    );
}

fn outcome_names() -> [&'static str; 6] {
    [
        Status::Unspecified,
        Status::Solved,
        Status::IterationLimit,
        Status::Infeasible,
        Status::NumericalError,
        Status::CheckFailed,
    ]
    .map(|status| Outcome::Replied(status).name())
}

#[test]
fn nobody_is_asked_without_a_replica_or_without_time() {
    let mut lonely = driver(&[]);
    tick(&mut lonely, ms(20));
    let step = decided(&mut lonely);
    assert_eq!((step.outcome, step.asked), (Outcome::Unreachable, 0));
    assert_eq!(step.replica, None);

    let mut hurried = driver(&["a"]);
    hurried.tick(ms(20), ms(20), measurement()).unwrap();
    let step = decided(&mut hurried);
    assert_eq!((step.outcome, step.asked), (Outcome::Late, 0));

    let mut failed = driver(&["a", "b"]);
    tick(&mut failed, ms(40));
    let query = asked(&mut failed);
    failed.ended(ms(56), query.id);
    assert_eq!(decided(&mut failed).asked, 1, "the deadline has passed");
}

#[test]
fn a_replica_that_goes_while_another_one_is_awaited_changes_nothing() {
    let mut driver = driver(&["a", "b", "c"]);
    tick(&mut driver, ms(20));
    let query = asked(&mut driver);
    let others = ["a", "b", "c"].map(name);
    let other = others.iter().find(|name| **name != query.replica).unwrap();
    driver.replica_gone(ms(21), other);
    assert!(driver.next_action().is_none());
    driver.ended(ms(22), query.id);
    let next = asked(&mut driver);
    driver.replied(ms(23), next.id, &solved(&next).encode(), b"");
    assert!(decided(&mut driver).outcome.is_solved());
}

#[test]
fn late_answers_are_awaited_as_long_as_queries_listen() {
    for (listened, late) in [(LISTEN, 1), (LISTEN + Duration::from_nanos(1), 0)] {
        let mut driver = driver(&["a"]);
        tick(&mut driver, ms(20));
        let query = asked(&mut driver);
        driver.wake(ms(36));
        decided(&mut driver);
        let now = ms(36) + listened;
        tick(&mut driver, now);
        asked(&mut driver);
        driver.replied(now, query.id, &solved(&query).encode(), b"");
        driver.wake(now + BUDGET);
        assert_eq!(decided(&mut driver).late.len(), late, "{listened:?}");
    }
}

#[test]
fn at_most_64_late_answers_are_awaited() {
    for (periods, kept) in [(64, true), (65, false)] {
        let mut driver = driver(&["a"]);
        let mut queries = Vec::new();
        for period in 1..=periods {
            // A period that begins before the last one was decided gives that one up.
            tick(&mut driver, ms(period));
            queries.push(asked(&mut driver));
        }
        for query in [&queries[0], &queries[1]] {
            driver.replied(ms(66), query.id, &solved(query).encode(), b"");
        }
        driver.wake(ms(periods) + BUDGET);
        let late = decided(&mut driver).late;
        assert_eq!(late.len(), 1 + usize::from(kept), "{periods}");
        assert_eq!(
            late.last().unwrap().reply_bytes,
            solved(&queries[1]).encode()
        );
    }
}

#[test]
fn a_reset_forgets_everything_but_the_count_of_periods() {
    let mut driver = driver(&["a"]);
    answered_period(&mut driver, ms(20));
    tick(&mut driver, ms(40));
    let query = asked(&mut driver);
    driver.reset();
    assert_eq!((driver.mode(), driver.next_wake()), (Mode::Waiting, None));
    assert!(driver.weights().is_empty());
    driver.replied(ms(41), query.id, &solved(&query).encode(), b"");
    tick(&mut driver, ms(60));
    let request = request(&asked(&mut driver));
    assert_eq!(request.sequence, 3);
    assert!(request.history_z.is_empty() && request.plan_u.is_empty());
    driver.wake(ms(76));
    let step = decided(&mut driver);
    assert_eq!((step.command.mode, step.late.len()), (Mode::Waiting, 0));
}

#[test]
fn a_reset_discards_what_was_still_to_be_done() {
    let mut driver = driver(&["a"]);
    tick(&mut driver, ms(20));
    driver.reset();
    assert!(driver.next_action().is_none());
}

#[test]
fn weights_can_be_given_and_held() {
    let mut driver = driver(&["a"]);
    answered_period(&mut driver, ms(20));
    answered_period(&mut driver, ms(40));
    driver.start_from(vec![1.0, 0.0]);
    assert_eq!(driver.weights(), [1.0, 0.0]);
    tick(&mut driver, ms(60));
    let given = request(&asked(&mut driver));
    assert_eq!((given.weights, given.history_z.len()), (vec![1.0, 0.0], 2));
    driver.hold_weights(vec![0.5, 0.5]);
    tick(&mut driver, ms(80));
    let held = request(&asked(&mut driver));
    assert_eq!((held.weights, held.history_z.len()), (vec![0.5, 0.5], 0));
}
