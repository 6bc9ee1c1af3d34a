//! Requests that cannot be answered get a typed error while another vehicle is served.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use crate::loopback::{
    Client, Outcome, Watched, config, engine, first_request, free_endpoint, step_key,
};
use egp_service::{Handler, Server};
use egp_wire::{Code, Request};

const POISON: u64 = 666;

/// An engine that panics on one sequence number.
fn fragile() -> impl Handler {
    Watched {
        engine: engine(),
        before: |sequence| assert!(sequence != POISON, "this panic is part of a test"),
    }
}

fn spoiled(spoil: impl FnOnce(&mut Request)) -> Vec<u8> {
    let mut request = first_request();
    spoil(&mut request);
    request.encode()
}

fn cases() -> Vec<(&'static str, Vec<u8>, Code, &'static str)> {
    let good = first_request().encode();
    vec![
        (
            "noise",
            vec![0xff; 200],
            Code::Malformed,
            "not an egp.v1 message",
        ),
        (
            "empty",
            vec![],
            Code::Version,
            "is empty or has no `version`",
        ),
        (
            "truncated",
            good[..good.len() / 2].to_vec(),
            Code::Malformed,
            "not an egp.v1 message",
        ),
        (
            "oversized",
            vec![0; 300_000],
            Code::Malformed,
            "at most 262144",
        ),
        (
            "larger than zenoh's clients accept",
            vec![0; 3 << 20],
            Code::Malformed,
            "3145728 bytes, at most 262144",
        ),
        (
            "NaN",
            spoiled(|r| r.x[2] = f64::NAN),
            Code::InvalidField,
            "not finite",
        ),
        (
            "wrong unit",
            spoiled(|r| r.x[2] = 120.0),
            Code::InvalidField,
            "check unit",
        ),
        (
            "horizon",
            spoiled(|r| {
                r.reference.pop();
                r.widths.clear();
            }),
            Code::InvalidField,
            "[T+1, 4]",
        ),
        (
            "library",
            spoiled(|r| r.library = [9; 32]),
            Code::UnknownLibrary,
            "this replica serves",
        ),
        (
            "late",
            spoiled(|r| r.budget_us = 1),
            Code::TooLate,
            "no answer within 1 us",
        ),
        (
            "defect",
            spoiled(|r| r.sequence = POISON),
            Code::Internal,
            "defect of the service",
        ),
    ]
}

#[test]
fn bad_requests_get_typed_errors_while_another_vehicle_is_served() {
    let endpoint = free_endpoint();
    let server = Server::start_with(&config(&endpoint), fragile()).unwrap();
    let (stop, served) = (
        Arc::new(AtomicBool::new(false)),
        Arc::new(AtomicU32::new(0)),
    );
    let good = {
        let (client, stop, served) = (Client::connect(&endpoint), stop.clone(), served.clone());
        let bytes = first_request().encode();
        std::thread::spawn(move || {
            while !stop.load(Ordering::Relaxed) {
                let outcome = client.ask(&step_key("good"), &bytes);
                assert!(matches!(outcome, Outcome::Answer { .. }), "{outcome:?}");
                served.fetch_add(1, Ordering::Relaxed);
            }
        })
    };
    let client = Client::connect(&endpoint);
    while served.load(Ordering::Relaxed) == 0 {
        std::thread::yield_now();
    }
    for round in 0..3 {
        for (name, bytes, code, words) in cases() {
            match client.ask(&step_key("bad"), &bytes) {
                Outcome::Error(error) => {
                    assert_eq!(error.code, code, "{name}, round {round}: {error}");
                    assert!(error.detail.contains(words), "{name}: {error}");
                    if name == "wrong unit" {
                        assert_eq!(error.field, "x", "{error}");
                    }
                }
                other => panic!("{name}: {other:?}"),
            }
        }
    }
    let before = served.load(Ordering::Relaxed);
    while served.load(Ordering::Relaxed) < before + 3 {
        assert!(
            !good.is_finished(),
            "the good vehicle was not served to the end"
        );
        std::thread::yield_now();
    }
    stop.store(true, Ordering::Relaxed);
    good.join().unwrap();
    server.drain();
}

#[test]
fn keys_that_are_none_are_refused() {
    let endpoint = free_endpoint();
    let server = Server::start_with(&config(&endpoint), engine()).unwrap();
    let client = Client::connect(&endpoint);
    for key in [
        "egp/v1/r/main/fleet/car/stop",
        "egp/v1/r/main/step",
        "egp/v1/r/*/fleet/car/step",
    ] {
        match client.ask(key, &first_request().encode()) {
            Outcome::Error(error) => {
                assert!(error.detail.contains("no key of this replica"), "{key}");
            }
            other => panic!("{key}: {other:?}"),
        }
    }
    server.drain();
}
