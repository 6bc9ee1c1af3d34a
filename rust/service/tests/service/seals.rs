//! With keys of vehicles, a request is served only if it is sealed with its vehicle's key, and only once.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

use std::path::PathBuf;

use crate::loopback::{Client, Outcome, config, engine, first_request, free_endpoint, step_key};
use egp_service::{Server, check};
use egp_wire::keys::{self, Name};
use egp_wire::{Code, KeyRing, Seal, Timing, VehicleKey, WireError};
use prost::Message as _;
use zenoh::Wait;

fn name(text: &str) -> Name {
    text.parse().unwrap()
}

fn key(ring: &str, vehicle: &str) -> VehicleKey {
    let ring = KeyRing::parse(ring).unwrap();
    ring.get(&name("fleet"), &name(vehicle)).unwrap().clone()
}

fn sealed(secret: &VehicleKey, vehicle: &str, key: &str, payload: &[u8], number: u64) -> Seal {
    Seal {
        vehicle: (name("fleet"), name(vehicle)),
        run: 11,
        number,
        tag: secret.question(key, 11, number, payload),
    }
}

/// Payload and timing of the answer, or the error.
fn ask(
    client: &Client,
    key: &str,
    payload: &[u8],
    seal: Option<&Seal>,
) -> Result<(Vec<u8>, Timing), WireError> {
    let replies = client
        .session
        .get(key)
        .payload(payload.to_vec())
        .attachment(seal.map(Seal::encode))
        .wait()
        .unwrap();
    match replies.recv().unwrap().into_result() {
        Ok(sample) => {
            let attached = sample.attachment().unwrap().to_bytes().into_owned();
            let timing = Timing::decode(&*attached).unwrap();
            Ok((sample.payload().to_bytes().into_owned(), timing))
        }
        Err(error) => Err(WireError::decode(&error.payload().to_bytes()).unwrap()),
    }
}

fn key_file(name: &str, text: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn only_the_vehicle_itself_takes_its_slot_and_only_the_service_can_answer() {
    let text = format!(
        "fleet/car {}\nfleet/other {}\n",
        "a1".repeat(32),
        "b2".repeat(32)
    );
    let endpoint = free_endpoint();
    let mut config = config(&endpoint);
    config.vehicle_keys = Some(key_file("vehicles.keys", &text));
    let server = Server::start_with(&config, engine()).unwrap();
    let client = Client::connect(&endpoint);
    let (own, other) = (key(&text, "car"), key(&text, "other"));
    let (step, request) = (step_key("car"), first_request().encode());

    let seal = sealed(&own, "car", &step, &request, 1);
    let (reply, timing) = ask(&client, &step, &request, Some(&seal)).unwrap();
    assert!(own.is_answer(&seal.tag, &reply, &timing.tag));
    assert!(!other.is_answer(&seal.tag, &reply, &timing.tag));
    assert!(timing.step_us > 0);

    let next = |secret, vehicle| sealed(secret, vehicle, &step, &request, 2);
    let elsewhere = sealed(&own, "car", &step_key("other"), &request, 2);
    let another = sealed(&own, "car", &step, b"another", 2);
    for (seal, reason) in [
        (None, "has no seal"),
        (Some(seal), "came before"),
        (
            Some(next(&other, "car")),
            "not made with this vehicle's key",
        ),
        (
            Some(next(&other, "other")),
            "not made with this vehicle's key",
        ),
        (Some(elsewhere), "not made with this vehicle's key"),
        (Some(another), "not made with this vehicle's key"),
    ] {
        let error = ask(&client, &step, &request, seal.as_ref()).unwrap_err();
        assert_eq!(error.code, Code::Unauthenticated, "{reason}");
        assert!(error.detail.contains(reason), "{reason}: {}", error.detail);
    }
    let attached = client.session.get(&step).payload(request.clone());
    let replies = attached.attachment(vec![0xff; 50]).wait().unwrap();
    let error = replies.recv().unwrap().into_result().unwrap_err();
    let error = WireError::decode(&error.payload().to_bytes()).unwrap();
    assert!(
        error
            .detail
            .contains("the attachment of the request is no seal"),
        "{error}"
    );
    // A second client with the same key, of another run, is served, but noticed when the first one goes on.
    for (run, number) in [(12, 1), (11, 3), (12, 2)] {
        let seal = Seal {
            run,
            number,
            tag: own.question(&step, run, number, &request),
            ..sealed(&own, "car", &step, &request, 0)
        };
        ask(&client, &step, &request, Some(&seal)).unwrap();
    }
    let metrics = match client.ask(&keys::metrics(&name("main")), &[]) {
        Outcome::Answer { payload, .. } => String::from_utf8(payload).unwrap(),
        other => panic!("{other:?}"),
    };
    assert!(
        metrics.contains("egp_identity_twice_total 2\n"),
        "{metrics}"
    );
    assert!(
        metrics.contains("{outcome=\"unauthenticated\"} 7\n"),
        "{metrics}"
    );

    let stranger = ask(&client, &step_key("stranger"), &request, None).unwrap_err();
    assert!(stranger.detail.contains("no key of fleet/stranger"));

    let ready = keys::ready(&name("main"));
    let question = sealed(&own, "car", &ready, &[], 1);
    let (description, timing) = ask(&client, &ready, &[], Some(&question)).unwrap();
    assert!(own.is_answer(&question.tag, &description, &timing.tag));
    server.drain();
}

#[test]
fn vehicles_are_added_and_removed_while_the_service_runs() {
    let line = |vehicle: &str, byte: &str| format!("fleet/{vehicle} {}\n", byte.repeat(32));
    let (car, other) = (line("car", "a1"), line("other", "b2"));
    let endpoint = free_endpoint();
    let mut config = config(&endpoint);
    config.vehicle_keys = Some(key_file("changing.keys", &car));
    let server = Server::start_with(&config, engine()).unwrap();
    let client = Client::connect(&endpoint);
    let (text, request) = (format!("{car}{other}"), first_request().encode());
    let mut number = 0;
    let mut served = |vehicle: &str| {
        number += 1;
        let step = step_key(vehicle);
        let seal = sealed(&key(&text, vehicle), vehicle, &step, &request, number);
        ask(&client, &step, &request, Some(&seal)).is_ok()
    };
    assert_eq!((served("car"), served("other")), (true, false));
    for (file, expected) in [
        (text.as_str(), (true, true)),
        ("fleet/car 12\n", (true, true)), // no key: those of before hold
        (other.as_str(), (false, true)),
    ] {
        key_file("changing.keys", file);
        // This server has no library file, which is its second answer to the command.
        assert!(server.reload().is_err());
        assert_eq!((served("car"), served("other")), expected, "{file}");
    }
    let metrics = match client.ask(&keys::metrics(&name("main")), &[]) {
        Outcome::Answer { payload, .. } => String::from_utf8(payload).unwrap(),
        other => panic!("{other:?}"),
    };
    for (outcome, count) in [("read", 2), ("failed", 1)] {
        let line = format!("egp_key_reloads_total{{outcome=\"{outcome}\"}} {count}\n");
        assert!(metrics.contains(&line), "{line}: {metrics}");
    }
}

#[test]
fn keys_that_cannot_be_read_prevent_the_start() {
    let mut config = config(&free_endpoint());
    config.library = crate::loopback::library_file("keys.safetensors");
    config.vehicle_keys = Some("nowhere.keys".into());
    let missing = check(&config).unwrap_err().to_string();
    assert!(
        missing.contains("keys of the vehicles nowhere.keys"),
        "{missing}"
    );
    config.vehicle_keys = Some(key_file("bad.keys", "fleet/car 12"));
    let bad = check(&config).unwrap_err().to_string();
    assert!(bad.contains("bad.keys: line 1"), "{bad}");
}
