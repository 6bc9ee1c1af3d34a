//! This version reads and writes the golden files.

use egp_testing::messages;
use egp_wire::{Ready, Reply, Request, WireError};

fn golden(name: &str) -> Vec<u8> {
    let path = format!(
        "{}/../../tests/golden/{name}.bin",
        env!("CARGO_MANIFEST_DIR")
    );
    std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

#[test]
fn encoding_gives_the_golden_bytes() {
    for (name, bytes) in messages::all() {
        assert!(
            bytes == golden(name),
            "{name} changed: a new wire version, or a mistake"
        );
    }
}

#[test]
fn decoding_the_golden_bytes_gives_the_messages() {
    let request = |name| Request::decode(&golden(name)).unwrap();
    let reply = |name| Reply::decode(&golden(name)).unwrap();
    assert_eq!(request("wire_request_full"), messages::full_request());
    assert_eq!(request("wire_request_cold"), messages::cold_request());
    assert_eq!(reply("wire_reply_solved"), messages::solved_reply());
    assert_eq!(reply("wire_reply_infeasible"), messages::infeasible_reply());
    assert_eq!(
        WireError::decode(&golden("wire_error")).unwrap(),
        messages::error()
    );
    assert_eq!(
        Ready::decode(&golden("wire_ready")).unwrap(),
        messages::ready()
    );
}
