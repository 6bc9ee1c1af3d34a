//! Encodings that protobuf leaves to the writer of a message, and that a reader must therefore accept.

use egp_testing::messages;
use egp_wire::{Code, Invalid, Reply, Request, Status, WireError, code_name, proto, status_name};
use prost::Message as _;
use prost::encoding::{WireType, encode_key, encode_varint};

/// A length-delimited field.
fn delimited(tag: u32, content: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    encode_key(tag, WireType::LengthDelimited, &mut out);
    encode_varint(content.len() as u64, &mut out);
    out.extend(content);
    out
}

fn varint(tag: u32, value: u64) -> Vec<u8> {
    let mut out = Vec::new();
    encode_key(tag, WireType::Varint, &mut out);
    encode_varint(value, &mut out);
    out
}

/// The cold request with another tensor for the field `tag`, given by its bytes.
fn with_tensor(tag: u32, tensor: &[u8]) -> Result<Request, Invalid> {
    let bytes = [messages::cold_request().encode(), delimited(tag, tensor)].concat();
    Request::decode(&bytes)
}

fn data(values: &[f64]) -> Vec<u8> {
    let bytes: Vec<u8> = values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    delimited(2, &bytes)
}

#[test]
fn a_shape_may_be_packed_or_not_and_may_follow_its_data() {
    const WEIGHTS: u32 = 7;
    let values = data(&[0.25, 0.75]);
    for tensor in [
        [delimited(1, &[2]), values.clone()].concat(),
        [varint(1, 2), values.clone()].concat(),
        [values.clone(), varint(1, 2)].concat(),
        [
            varint(9, 5),
            delimited(1, &[]),
            varint(1, 2),
            values.clone(),
        ]
        .concat(),
    ] {
        assert_eq!(with_tensor(WEIGHTS, &tensor).unwrap().weights, [0.25, 0.75]);
    }
    for spoiled in [
        values.clone(),
        [delimited(1, &[1, 2]), values.clone()].concat(),
        [varint(1, 3), values.clone()].concat(),
        [varint(1, 2), varint(2, 7)].concat(),
        [delimited(1, &[0x80]), values].concat(),
    ] {
        assert!(with_tensor(WEIGHTS, &spoiled).is_err(), "{spoiled:?}");
    }
}

#[test]
fn the_shape_of_a_tensor_is_exactly_that_of_its_field() {
    const PLAN_U: u32 = 9;
    let shaped = |shape: &[u8]| {
        let values = data(&[0.0; 8]);
        with_tensor(PLAN_U, &[delimited(1, shape), values].concat()).unwrap_err()
    };
    for shape in [&[2, 4][..], &[8], &[4, 2, 1], &[2, 2, 2], &[1, 4, 2]] {
        let error = shaped(shape).to_string();
        assert!(
            error.starts_with("plan_u: expected shape [n, 2]"),
            "{error}"
        );
    }
    let error = shaped(&[4, 2]).to_string();
    assert!(error.starts_with("plan_x: expected 5 rows"), "{error}");
}

#[test]
fn of_a_number_that_comes_twice_the_last_counts() {
    let once = messages::cold_request();
    let bytes = [once.encode(), varint(3, 99), varint(16, 2)].concat();
    let request = Request::decode(&bytes).unwrap();
    assert_eq!((request.sequence, request.want_sigma), (99, true));
}

#[test]
fn a_number_beyond_32_bits_is_cut_to_them() {
    let bytes = [messages::cold_request().encode(), varint(4, (1 << 32) + 5)].concat();
    let request = Request::decode(&bytes).unwrap();
    assert_eq!(request.budget_us, 5);
}

#[test]
fn fields_of_a_later_version_are_skipped() {
    let mut bytes = messages::cold_request().encode();
    for wire_type in [WireType::SixtyFourBit, WireType::ThirtyTwoBit] {
        encode_key(100, wire_type, &mut bytes);
        bytes.extend([7; 8].iter().take(if wire_type == WireType::ThirtyTwoBit {
            4
        } else {
            8
        }));
    }
    let bytes = [bytes, varint(101, 5), delimited(102, b"later")].concat();
    let request = Request::decode(&bytes).unwrap();
    assert_eq!(request, messages::cold_request());
}

#[test]
fn each_field_has_the_type_of_the_proto() {
    let (request, reply) = (
        messages::cold_request().encode(),
        messages::solved_reply().encode(),
    );
    let spoil = |bytes: &[u8], field: &[u8]| [bytes, field].concat();
    for tag in [1, 3, 4, 10, 16] {
        let error = Request::decode(&spoil(&request, &delimited(tag, &[])));
        assert!(matches!(error, Err(Invalid::Field { .. })), "field {tag}");
    }
    for tag in [2, 5, 6, 7, 8, 9, 11, 12, 13, 14, 15] {
        let error = Request::decode(&spoil(&request, &varint(tag, 0)));
        assert!(matches!(error, Err(Invalid::Field { .. })), "field {tag}");
    }
    for tag in [10, 12, 13] {
        let error = Reply::decode(&spoil(&reply, &varint(tag, 0)));
        assert!(matches!(error, Err(Invalid::Field { .. })), "field {tag}");
    }
    let not_text = spoil(&reply, &delimited(13, &[0xff]));
    assert!(matches!(
        Reply::decode(&not_text),
        Err(Invalid::Field {
            field: "solver",
            ..
        })
    ));
}

#[test]
fn the_diagnostics_of_a_reply_are_written_and_read() {
    let reply = messages::solved_reply();
    let raw = proto::StepReply::decode(&*reply.encode()).unwrap();
    assert_eq!(raw.dropped_mass, reply.dropped_mass);
    assert_eq!(raw.kkt_residual, reply.kkt_residual);
    assert_eq!(
        (raw.iterations, raw.solver),
        (reply.iterations, reply.solver)
    );
}

#[test]
fn codes_are_spelled_in_lower_case() {
    for (code, name) in [
        (Code::TooLate, "too_late"),
        (Code::UnknownLibrary, "unknown_library"),
        (Code::Unspecified, "unspecified"),
    ] {
        assert_eq!(WireError::permanent(code, "").code_name(), name);
    }
}

#[test]
fn names_of_codes_and_statuses_are_those_of_the_schema() {
    let codes: Vec<_> = (0..64).filter_map(|n| Code::try_from(n).ok()).collect();
    assert_eq!(codes.len(), 11);
    for code in codes {
        let schema = code.as_str_name().strip_prefix("CODE_").unwrap();
        assert_eq!(code_name(code), schema.to_ascii_lowercase());
    }
    let statuses: Vec<_> = (0..64).filter_map(|n| Status::try_from(n).ok()).collect();
    assert_eq!(statuses.len(), 6);
    for status in statuses {
        let schema = status.as_str_name().strip_prefix("STATUS_").unwrap();
        assert_eq!(status_name(status), schema.to_ascii_lowercase());
    }
}

#[test]
fn an_error_says_whether_to_try_again_and_where_it_was() {
    let later = WireError::retryable(Code::Overloaded, 500, "the queue is full");
    assert_eq!((later.retryable, later.retry_after_us), (true, 500));
    assert_eq!(later.to_string(), "the queue is full");
    assert_eq!(WireError::decode(&later.encode()).unwrap(), later);
    let hostile = WireError {
        field: "x\r".to_owned(),
        detail: "é \u{1b}[2J\nservice: ready\u{9b}\u{7f}".to_owned(),
        ..later
    };
    let shown = WireError::decode(&hostile.encode()).unwrap();
    let (field, detail) = (shown.field.as_str(), shown.detail.as_str());
    let expected = "é \u{fffd}[2J\u{fffd}service: ready\u{fffd}\u{fffd}";
    assert_eq!((field, detail), ("x\u{fffd}", expected));
    let never = WireError::permanent(Code::UnknownLibrary, "ask for another");
    assert_eq!((never.retryable, never.retry_after_us), (false, 0));

    let refused = Invalid::Field {
        field: "x",
        reason: "is absent".to_owned(),
    };
    let error = WireError::from(refused);
    assert_eq!(
        (error.code, error.field.as_str()),
        (Code::InvalidField, "x")
    );
    assert_eq!(error.to_string(), "x: is absent");
    let version = WireError::from(Invalid::Version { actual: 2 });
    assert_eq!((version.code, version.retryable), (Code::Version, false));
}
