//! A short ramp with recorded requests against a real service: the counts must add up.
#![allow(clippy::unwrap_used, missing_docs)]

use std::process::{Command, Output};

use egp_core::{Kernel, Library, Settings, library};
use egp_driver::Carry;
use egp_service::{Server, ServiceConfig};
use egp_testing::libraries;
use egp_testing::ports::free_endpoint;
use egp_wire::{LibraryId, keys};
use serde_json::Value;
use zenoh::Wait as _;

const LIBRARY: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../python/egp_service/shipped/demo-library.safetensors"
);

/// A file of two requests of a car on a straight road, for a horizon of 40 periods of 20 ms.
fn requests_file(name: &str, library: LibraryId) -> String {
    requests_of(name, library, 40, 0.02)
}

/// A file of two requests of a car on a straight road, for a horizon of so many periods of `dt` s.
fn requests_of(name: &str, library: LibraryId, horizon: u32, dt: f64) -> String {
    let mut carry = Carry::new(library, 25);
    let mut bytes = Vec::new();
    for lateral in [0.1, 0.2] {
        let reference = (0..=horizon).map(|t| [15.0 * dt * f64::from(t), 0.0, 15.0, 0.0]);
        let x = [0.0, lateral, 15.0, 0.0, 0.0, 0.0, 0.0];
        let widths = vec![[3.0, 3.0]; horizon as usize + 1];
        let request = carry.request(x, reference.collect(), widths, 1);
        let request = request.encode();
        prost::encode_length_delimiter(request.len(), &mut bytes).unwrap();
        bytes.extend(request);
    }
    let path = format!("{}/{name}", env!("CARGO_TARGET_TMPDIR"));
    std::fs::write(&path, bytes).unwrap();
    path
}

fn serve() -> (Server, String) {
    serve_too(&[])
}

/// A service of the library, and of these files.
fn serve_too(further: &[&str]) -> (Server, String) {
    serve_both(LIBRARY, further)
}

/// A service that describes the library of a file, and serves those of others, too.
fn serve_both(library: &str, further: &[&str]) -> (Server, String) {
    let endpoint = free_endpoint();
    let mut config = ServiceConfig::new(library);
    config.libraries = further.iter().map(Into::into).collect();
    config
        .zenoh
        .insert("listen/endpoints".to_owned(), format!("[\"{endpoint}\"]"));
    (Server::start(&config).unwrap(), endpoint)
}

fn replay(endpoint: &str, requests: &str, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egp-load"))
        .args(["--connect", endpoint, "--requests", requests])
        .args(more)
        .output()
        .unwrap()
}

#[test]
fn every_due_request_of_each_rate_is_accounted_for() {
    let library = Library::from_bytes(&std::fs::read(LIBRARY).unwrap()).unwrap();
    let requests = requests_file("requests.bin", library.id());
    let (server, endpoint) = serve();
    let json = concat!(env!("CARGO_TARGET_TMPDIR"), "/replay.json");
    // Nothing is answered within 2 us, a ten-thousandth of the period, so the ramp ends at the first rate.
    for (budget, rates, sessions) in [("1", 2, "1"), ("0.0001", 1, "2")] {
        let options = ["--vehicles", "2", "--seconds", "0.5", "--warm-up", "0.1"];
        let options = [options.as_slice(), &["--sessions", sessions]].concat();
        let more = [
            "--ramp", "0.01", "--most", "3", "--budget", budget, "--json", json,
        ];
        let output = replay(
            &endpoint,
            &requests,
            &[options.as_slice(), more.as_slice()].concat(),
        );
        let (text, errors) = (
            String::from_utf8(output.stdout),
            String::from_utf8(output.stderr),
        );
        let (text, errors) = (text.unwrap(), errors.unwrap());
        assert!(output.status.success(), "{errors}");
        let report: Value = serde_json::from_slice(&std::fs::read(json).unwrap()).unwrap();
        assert_eq!(report["rates"].as_array().unwrap().len(), rates, "{text}");
        for rate in report["rates"].as_array().unwrap() {
            // 25 periods of 20 ms in half a second.
            let vehicles = rate["vehicles"].as_u64().unwrap();
            assert_eq!(rate["requests"].as_u64().unwrap(), 25 * vehicles, "{text}");
            let outcomes = rate["outcomes"].as_object().unwrap();
            let sum: u64 = outcomes.values().map(|n| n.as_u64().unwrap()).sum();
            assert_eq!(sum, 25 * vehicles, "{text}");
            let solved = outcomes.get("solved").map_or(0, |n| n.as_u64().unwrap());
            assert_eq!(rate["in_deadline"].as_u64().unwrap(), solved, "{text}");
            assert_eq!(solved > 0, budget == "1", "{text} {outcomes:?}");
        }
        let knee = report["knee_vehicles"].as_u64();
        assert_eq!(knee, (budget == "1").then_some(3), "{text}");
    }
    server.drain();
}

#[test]
fn a_replica_that_says_nothing_gets_no_requests() {
    let library = Library::from_bytes(&std::fs::read(LIBRARY).unwrap()).unwrap();
    let requests = requests_file("silent.bin", library.id());
    let silent = free_endpoint();
    let mut config = zenoh::Config::default();
    let listen = format!("[\"{silent}\"]");
    config.insert_json5("listen/endpoints", &listen).unwrap();
    let multicast = "scouting/multicast/enabled";
    config.insert_json5(multicast, "false").unwrap();
    let session = zenoh::open(config).wait().unwrap();
    let key = keys::live(&"silent".parse().unwrap());
    let token = session.liveliness().declare_token(key).wait().unwrap();
    let (server, endpoint) = serve();
    // A vehicle tells both sides of each other, so that the silent one is asked alone first.
    for (endpoint, succeeds) in [(&silent, false), (&endpoint, true)] {
        let more = ["--connect", &silent, "--seconds", "0.1"];
        let output = replay(endpoint, &requests, &more);
        let errors = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.success(), succeeds, "{errors}");
        assert_eq!(errors.contains("no replica says"), !succeeds, "{errors}");
        assert!(errors.contains("replica silent does not say"), "{errors}");
    }
    token.undeclare().wait().unwrap();
    server.drain();
}

#[test]
fn a_recording_is_replayed_with_the_period_of_its_library() {
    let spec = libraries::spec(Kernel::Rbf, &[0.5, 1.1], 20, 3);
    let bytes = library::encode(&spec).unwrap();
    let further = concat!(env!("CARGO_TARGET_TMPDIR"), "/further.safetensors");
    std::fs::write(further, &bytes).unwrap();
    let id = Library::from_bytes(&bytes).unwrap().id();
    let horizon = Settings::default().horizon(&Library::from_bytes(&bytes).unwrap());
    let requests = requests_of("further.bin", id, u32::try_from(horizon).unwrap(), spec.dt);
    // The service states the period of the library that it describes, which is not that of the recording.
    let (server, endpoint) = serve_too(&[further]);
    let output = replay(&endpoint, &requests, &["--seconds", "0.1"]);
    let errors = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success(), "{errors}");
    assert!(
        errors.contains("do not state its control period"),
        "{errors}"
    );
    server.drain();
    let (server, endpoint) = serve_both(further, &[LIBRARY]);
    let json = concat!(env!("CARGO_TARGET_TMPDIR"), "/further.json");
    let output = replay(&endpoint, &requests, &["--seconds", "0.1", "--json", json]);
    let errors = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{errors}");
    let report: Value = serde_json::from_slice(&std::fs::read(json).unwrap()).unwrap();
    assert_eq!(report["period_s"].as_f64(), Some(spec.dt));
    server.drain();
}

#[test]
fn a_budget_below_a_microsecond_is_an_error_in_words() {
    let library = Library::from_bytes(&std::fs::read(LIBRARY).unwrap()).unwrap();
    let requests = requests_file("budget.bin", library.id());
    let (server, endpoint) = serve();
    // The period is 20 ms.
    let output = replay(&endpoint, &requests, &["--budget", "0.00004"]);
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success(), "{message}");
    assert!(message.contains("at least 1 us"), "{message}");
    server.drain();
}

#[test]
fn a_recording_of_another_library_is_an_error_in_words() {
    let requests = requests_file("others.bin", LibraryId::default());
    let (server, endpoint) = serve();
    let output = replay(&endpoint, &requests, &[]);
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success(), "{message}");
    assert!(
        message.contains("replica main serves another library"),
        "{message}"
    );
    server.drain();
}
