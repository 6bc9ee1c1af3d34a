//! Messages of the wire, from the golden ones. The second reader of the same bytes is prost.

use egp_testing::messages;
use egp_wire::{
    Header, KeyRing, LibraryFile, Ready, Reply, Request, Seal, Status, WireError, limits, proto,
};
use prost::Message as _;

use crate::edits::Words;
use crate::fuzz;

/// The golden messages whose name starts with `kind`.
fn golden(kind: &str) -> Vec<Vec<u8>> {
    let found = messages::all().into_iter();
    let found = found.filter(|(name, _)| name.starts_with(kind));
    let examples: Vec<_> = found.map(|(_, bytes)| bytes).collect();
    assert!(!examples.is_empty());
    examples
}

fn is_simplex(weights: &[f64]) -> bool {
    weights.iter().all(|weight| *weight >= -1e-6)
        && (weights.iter().sum::<f64>() - 1.0).abs() < 1e-5
}

fn all_finite(rows: &[impl AsRef<[f64]>]) -> bool {
    rows.iter()
        .flat_map(AsRef::as_ref)
        .all(|value| value.is_finite())
}

#[test]
fn an_accepted_request_is_in_its_domain_and_encodes_to_itself() {
    fuzz!(golden("wire_request"), Words::Doubles, |bytes: Vec<u8>| {
        let Ok(request) = Request::decode(&bytes) else {
            return;
        };
        let horizon = request.horizon();
        assert!((1..=limits::HORIZON).contains(&horizon));
        assert!(all_finite(&[request.x]) && all_finite(&request.reference));
        assert!(request.weights.is_empty() || is_simplex(&request.weights));
        assert!(all_finite(&request.plan_x) && all_finite(&request.plan_u));
        assert!([0, horizon].contains(&request.plan_u.len()));
        assert!(request.plan_shift as usize <= request.plan_u.len());
        assert_eq!(request.plan_x.is_empty(), request.plan_u.is_empty());
        assert!([0, horizon + 1].contains(&request.widths.len()));
        assert!([0, horizon + 2].contains(&request.road_friction.len()));
        assert!(all_finite(&request.road_friction));
        assert_eq!(request.history_z.len(), request.history_y.len());
        assert!(request.history_f.len() <= request.history_z.len());

        assert_eq!(Request::decode(&request.encode()).unwrap(), request);
        let second = proto::StepRequest::decode(&*bytes).unwrap().encode_to_vec();
        assert_eq!(Request::decode(&second).unwrap(), request);
    });
}

#[test]
fn an_accepted_library_file_encodes_to_itself() {
    let examples = [None, Some([7; 64])].map(|signature| {
        let bytes = 407_696;
        LibraryFile { bytes, signature }.encode()
    });
    fuzz!(examples, Words::Doubles, |bytes: Vec<u8>| {
        let Ok(file) = LibraryFile::decode(&bytes) else {
            return;
        };
        assert!(file.bytes > 0 && file.parts() > 0);
        assert_eq!(LibraryFile::decode(&file.encode()), Ok(file));
    });
}

#[test]
fn a_header_says_what_its_request_says() {
    fuzz!(golden("wire_request"), Words::Doubles, |bytes: Vec<u8>| {
        let (header, request) = (Header::decode(&bytes), Request::decode(&bytes));
        if let Ok(request) = request {
            let header = header.unwrap();
            assert_eq!(header.library, request.library);
            assert_eq!(
                (header.sequence, header.budget_us),
                (request.sequence, request.budget_us)
            );
        } else if let (Ok(header), Ok(raw)) = (header, proto::StepRequest::decode(&*bytes)) {
            assert_eq!(header.library, *raw.library);
            assert_eq!(
                (header.sequence, header.budget_us),
                (raw.sequence, raw.budget_us)
            );
        }
    });
}

#[test]
fn an_accepted_reply_is_in_its_domain_and_encodes_to_itself() {
    fuzz!(golden("wire_reply"), Words::Doubles, |bytes: Vec<u8>| {
        let Ok(reply) = Reply::decode(&bytes) else {
            return;
        };
        let horizon = reply.plan_u.len();
        assert_ne!(reply.status, Status::Unspecified);
        assert_eq!(reply.status == Status::Solved, horizon > 0);
        assert_eq!(
            reply.plan_x.len(),
            if horizon > 0 { horizon + 1 } else { 0 }
        );
        assert!(all_finite(&reply.plan_x) && all_finite(&reply.plan_u));
        assert!(is_simplex(&reply.weights) && all_finite(&reply.sigma));
        assert!(all_finite(&reply.history_f.values));
        assert!(reply.history_f.is_empty() || reply.history_f.members == reply.weights.len());

        // Compared as bytes, because the diagnostic numbers of a reply may be NaN.
        let again = reply.encode();
        assert_eq!(Reply::decode(&again).unwrap().encode(), again);
        let second = proto::StepReply::decode(&*bytes).unwrap().encode_to_vec();
        assert_eq!(Reply::decode(&second).unwrap().encode(), again);
    });
}

#[test]
fn an_accepted_description_of_a_replica_is_in_its_domain_and_encodes_to_itself() {
    fuzz!(golden("wire_ready"), Words::Doubles, |bytes: Vec<u8>| {
        let Ok(ready) = Ready::decode(&bytes) else {
            return;
        };
        assert!((1e-4..=1.0).contains(&ready.dt));
        assert!(ready.horizon as usize <= limits::HORIZON);
        assert!(ready.history as usize <= limits::HISTORY);
        assert_eq!(Ready::decode(&ready.encode()).unwrap(), ready);
    });
}

#[test]
fn an_accepted_error_encodes_to_itself() {
    fuzz!(golden("wire_error"), Words::Doubles, |bytes: Vec<u8>| {
        if let Ok(error) = WireError::decode(&bytes) {
            assert_eq!(WireError::decode(&error.encode()).unwrap(), error);
        }
    });
}

#[test]
fn an_accepted_seal_encodes_to_itself() {
    fuzz!(
        golden("wire_seal"),
        Words::Texts(&["a/b", ""]),
        |bytes: Vec<u8>| {
            if let Some(seal) = Seal::decode(&bytes) {
                assert_eq!(Seal::decode(&seal.encode()), Some(seal));
            }
        }
    );
}

#[test]
fn a_text_of_keys_is_read_or_an_error() {
    let text = format!("# keys\ndepot/car-7 {}\n", "0b".repeat(32)).into_bytes();
    fuzz!(vec![text], Words::Texts(&["/", "#", "+"]), |bytes: Vec<
        u8,
    >| {
        let _ = KeyRing::parse(&String::from_utf8_lossy(&bytes));
    });
}
