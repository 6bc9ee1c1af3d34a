//! The carry through lost, late and repeated replies.

use egp_driver::Carry;
use egp_wire::{Predictions, Reply, Request, Status};

const LIBRARY: [u8; 32] = [3; 32];
const HORIZON: usize = 4;

fn state(v_x: f64) -> [f64; 7] {
    [0.0, 0.0, v_x, 0.0, 0.0, 0.0, 0.0]
}

/// One control period at the speed `v_x`; the request must be valid.
fn period(carry: &mut Carry, v_x: f64, force: f64) -> Request {
    let request = carry.request(state(v_x), vec![[0.0; 4]; HORIZON + 1], vec![], 1000);
    request.validate().unwrap();
    carry.applied([force, 0.0]);
    request
}

/// The reply that a service would give, each prediction marked with `mark`.
fn answer(request: &Request, status: Status, mark: f64) -> Reply {
    let solved = status == Status::Solved;
    Reply {
        library: LIBRARY,
        sequence: request.sequence,
        status,
        plan_x: if solved {
            vec![request.x; HORIZON + 1]
        } else {
            vec![]
        },
        plan_u: if solved {
            vec![[1.0, 0.0]; HORIZON]
        } else {
            vec![]
        },
        weights: vec![0.5, 0.5],
        sigma: vec![],
        history_f: Predictions::new(2, vec![[mark; 3]; 2 * request.history_z.len()]),
        dropped_mass: 0.0,
        iterations: 1,
        kkt_residual: 0.0,
        solver: String::new(),
        friction: None,
    }
}

#[test]
fn each_period_adds_the_transition_of_the_last() {
    let mut carry = Carry::new(LIBRARY, 3);
    assert!(period(&mut carry, 10.0, 100.0).history_z.is_empty());
    let second = period(&mut carry, 10.5, 200.0);
    assert_eq!(second.history_z, [[10.0, 0.0, 0.0, 0.0, 100.0, 0.0]]);
    assert_eq!(second.history_y, [[0.5, 0.0, 0.0]]);
    assert_eq!(second.u_prev, [100.0, 0.0]);
    for v_x in [11.0, 12.0, 13.0] {
        period(&mut carry, v_x, 0.0);
    }
    let last = period(&mut carry, 14.0, 0.0);
    assert_eq!(
        last.history_y.iter().map(|y| y[0]).collect::<Vec<_>>(),
        [1.0, 1.0, 1.0]
    );
}

#[test]
fn predictions_stay_with_their_transition_when_replies_are_lost_or_late() {
    let mut carry = Carry::new(LIBRARY, 4);
    period(&mut carry, 10.0, 0.0);
    let second = period(&mut carry, 11.0, 0.0);
    let third = period(&mut carry, 12.0, 0.0);
    // The reply to the second comes a period late: it knows one of the two transitions.
    assert!(carry.accept(&answer(&second, Status::Solved, 2.0)));
    let fourth = period(&mut carry, 13.0, 0.0);
    assert_eq!((fourth.history_z.len(), fourth.history_f.len()), (3, 1));
    assert_eq!(fourth.plan_shift, 2);
    assert!(carry.accept(&answer(&fourth, Status::Solved, 4.0)));
    // One that comes after its successor brings nothing.
    assert!(!carry.accept(&answer(&third, Status::Solved, 3.0)));
    let fifth = period(&mut carry, 14.0, 0.0);
    assert_eq!((fifth.history_z.len(), fifth.history_f.len()), (4, 3));
    assert_eq!(fifth.history_f.values[0], [4.0; 3]);
    assert_eq!(fifth.plan_shift, 1);
}

#[test]
fn an_unsolved_reply_brings_weights_and_leaves_the_plan_to_age_out() {
    let mut carry = Carry::new(LIBRARY, 2);
    let first = period(&mut carry, 10.0, 0.0);
    carry.accept(&answer(&first, Status::Solved, 0.0));
    for shift in 1..4 {
        let request = period(&mut carry, 10.0, 0.0);
        assert_eq!((request.plan_shift, request.plan_u.len()), (shift, HORIZON));
        carry.accept(&answer(&request, Status::Infeasible, 0.0));
    }
    let request = period(&mut carry, 10.0, 0.0);
    assert_eq!((request.plan_shift, request.plan_u.len()), (0, 0));
    assert_eq!(request.weights, [0.5, 0.5]);
}

#[test]
fn a_reset_forgets() {
    let mut carry = Carry::new(LIBRARY, 2);
    let first = period(&mut carry, 10.0, 100.0);
    let reply = answer(&first, Status::Solved, 0.0);
    carry.reset();
    assert!(
        !carry.accept(&reply),
        "a reply from before the reset is stale"
    );
    let next = period(&mut carry, 10.0, 0.0);
    assert_eq!((next.sequence, next.u_prev), (2, [100.0, 0.0]));
    assert!(next.history_z.is_empty() && next.plan_u.is_empty() && next.weights.is_empty());
}

#[test]
fn a_gap_starts_the_history_anew() {
    let mut carry = Carry::new(LIBRARY, 3);
    assert_eq!((carry.library(), carry.sequence()), (LIBRARY, 0));
    period(&mut carry, 10.0, 100.0);
    assert_eq!(period(&mut carry, 11.0, 200.0).history_z.len(), 1);
    assert_eq!(carry.sequence(), 2);
    carry.skip(1);
    carry.applied([-50.0, 0.0]);
    assert_eq!(carry.sequence(), 3);
    let after = period(&mut carry, 12.0, 300.0);
    assert_eq!((after.history_z.len(), after.u_prev), (0, [-50.0, 0.0]));
    let next = period(&mut carry, 13.0, 0.0);
    assert_eq!(next.history_z, [[12.0, 0.0, 0.0, 0.0, 300.0, 0.0]]);
}

#[test]
fn transitions_are_differences_of_all_three_motions() {
    let mut carry = Carry::new(LIBRARY, 3);
    let reference = vec![[0.0; 4]; HORIZON + 1];
    carry.request(
        [0.0, 0.0, 10.0, 0.0, 1.0, 0.5, 0.1],
        reference.clone(),
        vec![],
        1,
    );
    carry.applied([100.0, 0.2]);
    let after = [0.0, 0.0, 12.0, 0.0, 4.0, 0.75, 0.2];
    let request = carry.request(after, reference, vec![], 1);
    assert_eq!(request.history_z, [[10.0, 1.0, 0.5, 0.1, 100.0, 0.2]]);
    assert_eq!(request.history_y, [[2.0, 3.0, 0.25]]);
}

#[test]
fn weights_are_given_until_a_reply_brings_others() {
    let mut carry = Carry::new(LIBRARY, 3);
    carry.start_from(vec![1.0, 0.0]);
    let first = period(&mut carry, 10.0, 0.0);
    assert_eq!(first.weights, [1.0, 0.0]);
    carry.accept(&answer(&first, Status::Solved, 0.0));
    assert_eq!(carry.weights(), [0.5, 0.5]);
    // A reply that comes late, after others were stated, brings none.
    let second = period(&mut carry, 10.0, 0.0);
    carry.start_from(vec![0.25, 0.75]);
    assert!(carry.accept(&answer(&second, Status::Solved, 0.0)));
    let third = period(&mut carry, 10.0, 0.0);
    assert_eq!(third.weights, [0.25, 0.75]);
    carry.accept(&answer(&third, Status::Solved, 0.0));
    assert_eq!(carry.weights(), [0.5, 0.5]);
    carry.hold_weights(vec![0.0, 1.0]);
    for _ in 0..2 {
        let held = period(&mut carry, 10.0, 0.0);
        assert_eq!((held.weights, held.history_z.len()), (vec![0.0, 1.0], 0));
    }
}

#[test]
fn predictions_of_another_number_of_members_are_not_mixed() {
    let mut carry = Carry::new(LIBRARY, 4);
    period(&mut carry, 10.0, 0.0);
    let second = period(&mut carry, 11.0, 0.0);
    carry.accept(&answer(&second, Status::Solved, 2.0));
    let third = period(&mut carry, 12.0, 0.0);
    let mut three = answer(&third, Status::Solved, 3.0);
    three.history_f = Predictions::new(3, vec![[3.0; 3]; 3]);
    carry.accept(&three);
    // The newer of the two transitions now has three predictions, the older one two.
    let fourth = period(&mut carry, 13.0, 0.0);
    assert_eq!((fourth.history_f.members, fourth.history_f.len()), (2, 1));
    assert_eq!(fourth.history_f.values, [[2.0; 3]; 2]);
}

#[test]
fn a_plan_of_another_horizon_is_discarded() {
    let mut carry = Carry::new(LIBRARY, 2);
    let first = period(&mut carry, 10.0, 0.0);
    let mut short = answer(&first, Status::Solved, 0.0);
    short.plan_x.pop();
    short.plan_u.pop();
    carry.accept(&short);
    let second = period(&mut carry, 10.0, 0.0);
    assert!(second.plan_x.is_empty() && second.plan_u.is_empty());
}
