//! Replies that do not answer the request or do not fit the library are not used.

use egp_driver::{DriverConfig, Outcome};
use egp_gate::Mode;
use egp_wire::{Code, Invalid, Predictions, Reply};

use crate::world::{
    answered_period, asked, config, configured, decided, driver, error, infeasible, ms, solved,
    tick,
};

/// Lets a replica answer the third period, whose request has two transitions, with a changed reply. Gives the field that
/// is named when the reply is not used.
fn at_fault(change: impl FnOnce(&mut Reply)) -> Option<&'static str> {
    let mut driver = driver(&["a"]);
    answered_period(&mut driver, ms(20));
    answered_period(&mut driver, ms(40));
    tick(&mut driver, ms(60));
    let query = asked(&mut driver);
    let mut reply = solved(&query);
    change(&mut reply);
    driver.replied(ms(61), query.id, &reply.encode(), b"");
    match decided(&mut driver).outcome {
        Outcome::Unusable(Invalid::Field { field, .. }) => Some(field),
        Outcome::Replied(_) => None,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_reply_must_be_the_answer_to_this_request() {
    assert_eq!(at_fault(|_| {}), None);
    assert_eq!(at_fault(|reply| reply.library = [0; 32]), Some("library"));
    assert_eq!(at_fault(|reply| reply.sequence = 2), Some("sequence"));
    assert_eq!(at_fault(|reply| reply.sequence = 4), Some("sequence"));
}

#[test]
fn a_reply_must_have_the_members_and_the_history_of_the_request() {
    let weights = |reply: &mut Reply, weights: &[f64]| {
        reply.weights = weights.to_vec();
        reply.history_f = Predictions::default();
    };
    assert_eq!(at_fault(|reply| weights(reply, &[0.5, 0.5])), None);
    assert_eq!(at_fault(|reply| weights(reply, &[1.0])), Some("weights"));
    let three = [0.5, 0.25, 0.25];
    assert_eq!(at_fault(|reply| weights(reply, &three)), Some("weights"));
    let predicted = |reply: &mut Reply, rows: usize| {
        reply.history_f = Predictions::new(2, vec![[0.5; 3]; 2 * rows]);
    };
    assert_eq!(at_fault(|reply| predicted(reply, 0)), None);
    assert_eq!(at_fault(|reply| predicted(reply, 1)), Some("history_f"));
    assert_eq!(at_fault(|reply| predicted(reply, 2)), None);
    assert_eq!(at_fault(|reply| predicted(reply, 3)), Some("history_f"));
}

#[test]
fn a_plan_and_its_deviations_have_the_horizon() {
    let sigma = |reply: &mut Reply, rows: usize| reply.sigma = vec![[0.1; 3]; rows];
    assert_eq!(at_fault(|reply| sigma(reply, 5)), None);
    assert_eq!(at_fault(|reply| sigma(reply, 4)), Some("sigma"));
    assert_eq!(at_fault(|reply| sigma(reply, 3)), Some("sigma"));
    let plan = |reply: &mut Reply, rows: usize| {
        reply.plan_x.truncate(rows + 1);
        reply.plan_u.truncate(rows);
    };
    assert_eq!(at_fault(|reply| plan(reply, 3)), Some("plan_u"));
}

#[test]
fn a_plan_begins_at_the_measured_state_and_stays_within_a_kilometre() {
    let moved = |reply: &mut Reply| reply.plan_x[0][2] += 1e-9;
    assert_eq!(at_fault(moved), Some("plan_x"));
    // The vehicle is at (3, 4).
    for (p_x, p_y, expected) in [
        (1003.0, 4.0, None),
        (3.0, 1004.0, None),
        (-997.0, 4.0, None),
        (3.0, -996.0, None),
        (1003.1, 4.0, Some("plan_x")),
        (3.0, -996.1, Some("plan_x")),
        (803.0, 804.0, Some("plan_x")),
    ] {
        let far = |reply: &mut Reply| reply.plan_x[4][..2].copy_from_slice(&[p_x, p_y]);
        assert_eq!(at_fault(far), expected, "{p_x} {p_y}");
    }
}

#[test]
fn a_reply_without_a_plan_needs_none() {
    let mut driver = driver(&["a"]);
    tick(&mut driver, ms(20));
    let query = asked(&mut driver);
    driver.replied(ms(21), query.id, &infeasible(&query).encode(), b"");
    let step = decided(&mut driver);
    assert_eq!(step.outcome.name(), "infeasible");
    assert!(step.reply.is_some());
}

#[test]
fn a_first_plan_that_is_older_than_a_tail_leaves_the_vehicle_waiting() {
    let config = DriverConfig {
        max_tail_ticks: Some(0),
        ..config()
    };
    let mut driver = configured(&["a"], config);
    tick(&mut driver, ms(20));
    let late = asked(&mut driver);
    driver.wake(ms(36));
    assert_eq!(decided(&mut driver).command.mode, Mode::Waiting);
    driver.replied(ms(39), late.id, &solved(&late).encode(), b"");
    tick(&mut driver, ms(40));
    asked(&mut driver);
    driver.wake(ms(56));
    let step = decided(&mut driver);
    assert_eq!((step.command.mode, step.late.len()), (Mode::Waiting, 1));
    answered_period(&mut driver, ms(60));
    assert_eq!(driver.mode(), Mode::Normal);
}

/// Two routers deliver a question twice; the service answers the copy that comes first with `SUPERSEDED`.
#[test]
fn a_copy_that_is_superseded_does_not_end_the_question() {
    let mut driver = driver(&["a"]);
    tick(&mut driver, ms(20));
    let query = asked(&mut driver);
    driver.refused(ms(21), query.id, &error(Code::Superseded));
    assert!(driver.next_action().is_none());
    driver.replied(ms(22), query.id, &solved(&query).encode(), b"");
    let step = decided(&mut driver);
    assert_eq!((step.outcome.name(), step.asked), ("solved", 1));
    driver.ended(ms(23), query.id);
    // Another client has the vehicle's key: the question ends without a reply.
    tick(&mut driver, ms(40));
    let query = asked(&mut driver);
    driver.refused(ms(41), query.id, &error(Code::Superseded));
    driver.ended(ms(41), query.id);
    assert_eq!(decided(&mut driver).outcome.name(), "refused");
}
