//! The error about a message that is not valid names the field at fault.

use crate::padded;
use egp_testing::messages;
use egp_wire::{Code, Header, Invalid, Ready, Reply, Request, WireError, limits, proto};
use prost::Message as _;

/// The field that the error about a request names after `spoil`.
fn refused(spoil: impl FnOnce(&mut Request)) -> String {
    let mut request = messages::full_request();
    spoil(&mut request);
    match Request::decode(&request.encode()) {
        Err(Invalid::Field { field, reason }) => format!("{field}: {reason}"),
        other => panic!("expected a refused field, got {other:?}"),
    }
}

/// The same on the level of protobuf, for faults that the typed request cannot express.
fn refused_raw(spoil: impl FnOnce(&mut proto::StepRequest)) -> Invalid {
    let mut raw = proto::StepRequest::decode(&*messages::full_request().encode()).unwrap();
    spoil(&mut raw);
    Request::decode(&raw.encode_to_vec()).unwrap_err()
}

#[test]
fn values_outside_the_domain_are_named() {
    assert!(refused(|r| r.x[2] = f64::NAN).starts_with("x: value 2 is not finite"));
    assert!(refused(|r| r.x[2] = 1e3).starts_with("x: row 0: v_x = 1000 is outside"));
    assert!(refused(|r| r.x[2] = 1e300).starts_with("x: row 0: v_x = 1e300 is outside"));
    assert!(refused(|r| r.u_prev[0] = f64::INFINITY).starts_with("u_prev"));
    assert!(refused(|r| r.plan_x[3][4] = -1e9).starts_with("plan_x: row 3: v_y"));
    assert!(refused(|r| r.history_f.values[2][2] = f64::NAN).starts_with("history_f"));
    assert!(refused(|r| r.budget_us = 0).starts_with("budget_us"));
    assert!(refused(|r| r.widths[1] = [-3.0, 1.0]).starts_with("widths: row 1: the edges cross"));
}

#[test]
fn weights_off_the_simplex_are_refused() {
    assert!(refused(|r| r.weights = vec![0.7, 0.7]).contains("sum to 1.4"));
    assert!(refused(|r| r.weights = vec![1.5, -0.5]).contains("weight 1 = -0.5 is negative"));
}

#[test]
fn fields_that_do_not_fit_together_are_refused() {
    assert!(refused(|r| r.plan_u.clear()).starts_with("plan_u: expected 4 rows"));
    assert!(refused(|r| r.plan_x.truncate(2)).starts_with("plan_x: expected 5 rows"));
    assert!(refused(|r| r.plan_shift = 5).starts_with("plan_shift: expected at most 4"));
    assert!(refused(|r| r.history_y.truncate(2)).starts_with("history_y: expected 3 rows"));
    assert!(refused(|r| r.weights = vec![1.0]).starts_with("history_f: expected 1 members"));
    assert!(refused(|r| _ = r.history_f.values.pop()).starts_with("history_f"));
    assert!(refused(|r| r.widths.truncate(2)).starts_with("widths: expected 5 rows"));
    assert!(refused(|r| _ = r.road_friction.pop()).starts_with("road_friction: expected 6 rows"));
    assert!(refused(|r| r.reference.clear()).starts_with("reference"));
    assert!(refused(|r| r.reference = vec![[0.0; 4]; 200]).contains("n from 1 to 129"));
    assert!(refused(|r| r.weights = vec![0.01; 100]).contains("n from 1 to 64"));
}

#[test]
fn shapes_and_data_must_agree() {
    let message = |invalid: Invalid| invalid.to_string();
    assert!(message(refused_raw(|r| r.x = None)).contains("x: is required and absent"));
    let short = refused_raw(|r| r.x.as_mut().unwrap().data.truncate(55));
    assert!(message(short).contains("needs 56 bytes of data, got 55"));
    let lying = refused_raw(|r| r.plan_u.as_mut().unwrap().shape = vec![u32::MAX, u32::MAX]);
    assert!(message(lying).starts_with("plan_u: expected shape"));
    assert!(
        message(refused_raw(|r| r.library.truncate(31))).contains("32 bytes of a SHA-256, got 31")
    );
    let rank = refused_raw(|r| r.x.as_mut().unwrap().shape = vec![7, 1, 1, 1, 1]);
    assert!(message(rank).starts_with("x: expected shape [7], got [7, 1, 1, 1]"));
    assert_eq!(
        refused_raw(|r| r.version = 2),
        Invalid::Version { actual: 2 }
    );
}

#[test]
fn truncated_and_oversized_messages_are_refused() {
    // Its last field is a required one, because protobuf cannot detect that a trailing optional field is missing.
    let bytes = messages::cold_request().encode();
    for length in 0..bytes.len() {
        assert!(
            Request::decode(&bytes[..length]).is_err(),
            "{length} bytes were accepted"
        );
    }
    let bytes = padded(bytes, limits::MESSAGE_BYTES + 1);
    let error = Request::decode(&bytes).unwrap_err();
    assert!(matches!(error, Invalid::TooLarge { .. }));
    assert_eq!(WireError::from(error).code, Code::Malformed);
}

#[test]
fn a_tensor_that_comes_twice_is_refused() {
    let bytes = messages::full_request().encode();
    let twice = [bytes.as_slice(), bytes.as_slice()].concat();
    let error = Request::decode(&twice).unwrap_err();
    assert_eq!(error.to_string(), "x: comes twice; send it once");
}

#[test]
fn a_field_of_another_type_is_refused() {
    // Field 5, `x`, as a number instead of a tensor.
    let bytes = [messages::cold_request().encode().as_slice(), &[5 << 3, 7]].concat();
    let error = Request::decode(&bytes).unwrap_err();
    assert!(
        error.to_string().starts_with("x: has another type"),
        "{error}"
    );
}

#[test]
fn the_header_is_read_alone() {
    let header = Header::decode(&messages::full_request().encode()).unwrap();
    assert_eq!((header.sequence, header.budget_us), (7, 40_000));
    let spoiled = refused_raw(|r| r.budget_us = 20_000_000);
    assert!(spoiled.to_string().starts_with("budget_us"));
}

#[test]
fn a_reply_cannot_carry_an_unsolved_plan() {
    let mut reply = messages::solved_reply();
    reply.status = egp_wire::Status::CheckFailed;
    let error = Reply::decode(&reply.encode()).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("present although nothing was solved")
    );
    let mut reply = messages::infeasible_reply();
    reply.status = egp_wire::Status::Solved;
    assert!(Reply::decode(&reply.encode()).is_err());
}

#[test]
fn an_invalid_vehicle_is_an_error_and_the_field_may_be_absent() {
    let mut raw = proto::Ready::decode(&*messages::ready().encode()).unwrap();
    if let Some(vehicle) = &mut raw.vehicle {
        vehicle.mass = -1200.0;
    }
    let error = Ready::decode(&raw.encode_to_vec()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "vehicle: vehicle parameter `mass` is -1200.0 kg: expected 1 to 100000; check its unit"
    );
    raw.vehicle = None;
    let ready = Ready::decode(&raw.encode_to_vec()).unwrap();
    assert_eq!(ready.vehicle, None);
}
