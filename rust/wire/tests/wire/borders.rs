//! Both sides of every limit: the last accepted value and the first one that is an error.

use crate::padded;
use egp_testing::messages;
use egp_wire::{Invalid, Predictions, Reply, Request, limits};

/// A request with a horizon of `horizon`, without plan, history and widths.
fn request_over(horizon: usize) -> Request {
    Request {
        reference: vec![[0.0; 4]; horizon + 1],
        ..messages::cold_request()
    }
}

/// A request with a history of `rows` rows, none of them predicted.
fn request_after(rows: usize) -> Request {
    Request {
        history_z: vec![[0.0; 6]; rows],
        history_y: vec![[0.0; 3]; rows],
        ..messages::cold_request()
    }
}

/// A reply whose plan has `horizon` inputs.
fn reply_over(horizon: usize) -> Reply {
    Reply {
        plan_x: vec![[0.0; 7]; horizon + 1],
        plan_u: vec![[0.0; 2]; horizon],
        sigma: vec![[0.0; 3]; horizon + 1],
        ..messages::solved_reply()
    }
}

fn decoded(request: &Request) -> Result<Request, Invalid> {
    Request::decode(&request.encode())
}

pub(crate) fn decoded_reply(reply: &Reply) -> Result<Reply, Invalid> {
    Reply::decode(&reply.encode())
}

/// The field that the error about `request` names.
fn refused(request: &Request) -> Option<&'static str> {
    field(&decoded(request))
}

/// The field that the error about `reply` names.
pub(crate) fn refused_reply(reply: &Reply) -> Option<&'static str> {
    field(&decoded_reply(reply))
}

/// The field that an error names.
pub(crate) fn field<T>(result: &Result<T, Invalid>) -> Option<&'static str> {
    match result {
        Err(Invalid::Field { field, .. }) => Some(field),
        _ => None,
    }
}

#[test]
fn each_component_is_accepted_up_to_its_limit() {
    let limits = [1e7, 1e7, 150.0, 1e5, 150.0, 50.0, 1.6];
    for (i, limit) in limits.into_iter().enumerate() {
        for sign in [-1.0, 1.0] {
            let mut request = messages::cold_request();
            request.x[i] = sign * limit;
            assert_eq!(decoded(&request).unwrap(), request);
            request.x[i] = sign * limit * (1.0 + 1e-15);
            assert_eq!(refused(&request), Some("x"), "component {i}");
        }
    }
}

#[test]
fn weights_are_a_simplex_up_to_rounding() {
    for accepted in [
        [1.0, 0.0],
        [1.0 + 9e-7, 0.0],
        [1.0 - 9e-7, 0.0],
        [1.0, -9e-7],
    ] {
        let mut request = messages::cold_request();
        request.weights = accepted.to_vec();
        assert_eq!(decoded(&request).unwrap().weights, accepted);
    }
    for spoiled in [[1.0 + 2e-6, 0.0], [1.0 - 2e-6, 0.0], [1.0 + 2e-6, -2e-6]] {
        let mut request = messages::cold_request();
        request.weights = spoiled.to_vec();
        assert_eq!(refused(&request), Some("weights"), "{spoiled:?}");
    }
}

#[test]
fn the_longest_horizon_is_accepted_in_both_directions() {
    let longest = limits::HORIZON;
    for horizon in [1, longest] {
        assert_eq!(decoded(&request_over(horizon)).unwrap().horizon(), horizon);
        let reply = reply_over(horizon);
        assert_eq!(decoded_reply(&reply).unwrap(), reply);
        let warm = Request {
            plan_x: vec![[0.0; 7]; horizon + 1],
            plan_u: vec![[0.0; 2]; horizon],
            plan_shift: u32::try_from(horizon).unwrap(),
            widths: vec![[0.0; 2]; horizon + 1],
            road_friction: vec![[0.5, 0.1]; horizon + 2],
            ..request_over(horizon)
        };
        assert_eq!(decoded(&warm).unwrap(), warm);
    }
    assert_eq!(refused(&request_over(0)), Some("reference"));
    assert_eq!(refused(&request_over(longest + 1)), Some("reference"));
    assert_eq!(refused_reply(&reply_over(longest + 1)), Some("plan_x"));
}

#[test]
fn validation_without_decoding_knows_the_same_horizons() {
    assert_eq!(field(&request_over(0).validate()), Some("reference"));
    let long = request_over(limits::HORIZON + 1);
    assert_eq!(field(&long.validate()), Some("reference"));
}

#[test]
fn the_longest_history_is_accepted() {
    let longest = request_after(limits::HISTORY);
    assert_eq!(decoded(&longest).unwrap(), longest);
    let longer = request_after(limits::HISTORY + 1);
    assert_eq!(refused(&longer), Some("history_z"));
    assert_eq!(field(&longer.validate()), Some("history_z"));
}

#[test]
fn the_largest_library_is_accepted() {
    let members = limits::MEMBERS;
    let request = |members: usize| Request {
        weights: vec![1.0 / members as f64; members],
        history_f: Predictions::new(members, vec![[0.0; 3]; 2 * members]),
        ..request_after(2)
    };
    assert_eq!(decoded(&request(members)).unwrap(), request(members));
    assert_eq!(refused(&request(members + 1)), Some("weights"));
    let unweighted = Request {
        weights: vec![],
        ..request(members + 1)
    };
    assert_eq!(refused(&unweighted), Some("history_f"));
}

#[test]
fn as_many_transitions_are_predicted_as_there_are_at_most() {
    let request = |predicted: usize| Request {
        history_f: Predictions::new(2, vec![[0.0; 3]; 2 * predicted]),
        weights: vec![0.5, 0.5],
        ..request_after(3)
    };
    for predicted in 0..=3 {
        let request = request(predicted);
        assert_eq!(request.history_f.len(), predicted);
        assert_eq!(request.history_f.is_empty(), predicted == 0);
        assert_eq!(decoded(&request).unwrap(), request);
    }
    assert_eq!(refused(&request(4)), Some("history_f"));
}

#[test]
fn predictions_fit_the_weights_when_both_are_there() {
    let request = |members: usize, weights: &[f64]| Request {
        history_f: Predictions::new(members, vec![[0.0; 3]; members]),
        weights: weights.to_vec(),
        ..request_after(1)
    };
    for accepted in [
        request(2, &[0.5, 0.5]),
        request(2, &[]),
        request(0, &[0.5, 0.5]),
    ] {
        assert_eq!(decoded(&accepted).unwrap(), accepted);
    }
    assert_eq!(refused(&request(3, &[0.5, 0.5])), Some("history_f"));
    let mut ragged = request(2, &[0.5, 0.5]);
    ragged.history_f.values.push([0.0; 3]);
    assert_eq!(field(&ragged.validate()), Some("history_f"));
    let mut not_finite = request(2, &[0.5, 0.5]);
    not_finite.history_f.values[1][2] = -1e7;
    assert_eq!(decoded(&not_finite).unwrap(), not_finite);
    not_finite.history_f.values[1][2] = -1e7 * (1.0 + 1e-15);
    assert_eq!(refused(&not_finite), Some("history_f"));
    not_finite.history_f.values[1][2] = f64::INFINITY;
    assert_eq!(field(&not_finite.validate()), Some("history_f"));
}

#[test]
fn half_a_plan_is_refused() {
    let full = messages::full_request();
    for spoiled in [
        Request {
            plan_x: vec![],
            ..full.clone()
        },
        Request {
            plan_u: vec![],
            ..full.clone()
        },
    ] {
        assert!(matches!(refused(&spoiled), Some("plan_x" | "plan_u")));
    }
    let nothing_to_shift = Request {
        plan_shift: 1,
        ..messages::cold_request()
    };
    assert_eq!(refused(&nothing_to_shift), Some("plan_shift"));
}

#[test]
fn edges_may_meet_but_not_cross() {
    let request = |left: f64, right: f64| {
        let mut request = messages::full_request();
        request.widths.fill([left, right]);
        request
    };
    for (left, right) in [(0.0, 0.0), (2.0, -2.0), (-1.0, 3.0), (1e4, 1e4)] {
        let request = request(left, right);
        assert_eq!(decoded(&request).unwrap(), request);
    }
    for (left, right) in [
        (2.0, -2.0 - 1e-9),
        (-0.5, 0.25),
        (-0.5, -0.5),
        (1e4 + 1e-3, 0.0),
    ] {
        assert_eq!(
            refused(&request(left, right)),
            Some("widths"),
            "{left} {right}"
        );
    }
}

#[test]
fn frictions_of_the_road_are_accepted_up_to_their_limits() {
    let request = |friction: f64, std: f64| {
        let mut request = messages::full_request();
        request.road_friction[5] = [friction, std];
        request
    };
    for (friction, std) in [(0.01, 0.0), (3.0, 3.0)] {
        let request = request(friction, std);
        assert_eq!(decoded(&request).unwrap(), request);
    }
    for (friction, std) in [
        (0.01 - 1e-9, 0.1),
        (3.0 + 1e-9, 0.1),
        (0.5, -1e-9),
        (0.5, 3.0 + 1e-9),
    ] {
        let found = refused(&request(friction, std));
        assert_eq!(found, Some("road_friction"), "{friction} {std}");
    }
}

#[test]
fn budgets_are_accepted_up_to_ten_seconds() {
    let request = |budget_us| Request {
        budget_us,
        ..messages::cold_request()
    };
    for budget_us in [1, 10_000_000] {
        assert_eq!(decoded(&request(budget_us)).unwrap().budget_us, budget_us);
    }
    for budget_us in [0, 10_000_001] {
        assert_eq!(refused(&request(budget_us)), Some("budget_us"));
    }
}

#[test]
fn messages_are_accepted_up_to_the_limit_of_bytes() {
    let request = |bytes| padded(messages::full_request().encode(), bytes);
    let reply = |bytes| padded(messages::solved_reply().encode(), bytes);
    Request::decode(&request(limits::MESSAGE_BYTES)).unwrap();
    Reply::decode(&reply(limits::MESSAGE_BYTES)).unwrap();
    assert!(matches!(
        Reply::decode(&reply(limits::MESSAGE_BYTES + 1)),
        Err(Invalid::TooLarge { .. })
    ));
}
