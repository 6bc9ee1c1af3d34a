//! The golden files are what this version reads and writes.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

mod fixtures;

use egp_wire::{Limits, Ready, Reply, Request, WireError};

fn golden(name: &str) -> Vec<u8> {
    let path = format!(
        "{}/../../tests/golden/{name}.bin",
        env!("CARGO_MANIFEST_DIR")
    );
    std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

#[test]
fn encoding_gives_the_golden_bytes() {
    for (name, bytes) in fixtures::all() {
        assert!(
            bytes == golden(name),
            "{name} changed: a new wire version, or a mistake"
        );
    }
}

#[test]
fn decoding_the_golden_bytes_gives_the_messages() {
    let limits = Limits::default();
    let request = |name| Request::decode(&golden(name), &limits).unwrap();
    let reply = |name| Reply::decode(&golden(name), &limits).unwrap();
    assert_eq!(request("wire_request_full"), fixtures::full_request());
    assert_eq!(request("wire_request_cold"), fixtures::cold_request());
    assert_eq!(reply("wire_reply_solved"), fixtures::solved_reply());
    assert_eq!(reply("wire_reply_infeasible"), fixtures::infeasible_reply());
    assert_eq!(
        WireError::decode(&golden("wire_error")).unwrap(),
        fixtures::error()
    );
    assert_eq!(
        Ready::decode(&golden("wire_ready"), &limits).unwrap(),
        fixtures::ready()
    );
}
