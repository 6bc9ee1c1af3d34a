//! Which requests a guard lets through.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::query::recorded::{Recorded, at, name};

/// A guard with the keys of the vehicles `a` and `b`, and the key of `a`.
fn guard() -> (Guard, VehicleKey) {
    let text = format!("fleet/a {}\nfleet/b {}\n", "a1".repeat(32), "b2".repeat(32));
    let ring = KeyRing::parse(&text).unwrap();
    let key = ring.get(&name("fleet"), &name("a")).unwrap().clone();
    (Guard::new(ring), key)
}

/// A request of `a` that is sealed with this key.
fn sealed(key: &VehicleKey, run: u64, number: u64) -> Recorded {
    let mut query = Recorded::request("a", 1, 1_000);
    let seal = Seal {
        vehicle: (name("fleet"), name("a")),
        run,
        number,
        tag: key.question(&query.key, run, number, &query.payload),
    };
    query.attachment = seal.encode();
    query
}

/// Checks a request of the vehicle `a`; the reason if it is not accepted.
fn accept(guard: &Guard, query: &Recorded) -> Result<Sealed, String> {
    guard
        .request(query, &name("fleet"), &name("a"))
        .map_err(|error| {
            assert_eq!(error.code, Code::Unauthenticated);
            error.detail
        })
}

#[test]
fn a_file_of_keys_that_every_user_may_read_is_a_warning() {
    use std::os::unix::fs::PermissionsExt as _;
    let file = std::env::temp_dir().join(format!("egp-exposed-{}", std::process::id()));
    std::fs::write(&file, "").unwrap();
    for (mode, expected) in [(0o600, false), (0o640, false), (0o644, true), (0o602, true)] {
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(mode)).unwrap();
        assert_eq!(exposed(&file).is_some(), expected, "{mode:o}");
    }
    std::fs::remove_file(&file).unwrap();
    assert_eq!(exposed(&file), None);
}

#[test]
fn the_sender_needs_the_key_of_the_vehicle() {
    let (guard, key) = guard();
    let mut query = sealed(&key, 7, 1);
    let tag = accept(&guard, &query).ok().unwrap().tag(b"reply");
    let question = Seal::decode(&query.attachment).unwrap().tag;
    assert!(key.is_answer(&question, b"reply", &tag));
    let unknown = guard.request(&query, &name("fleet"), &name("c"));
    assert_eq!(unknown.err().unwrap().code, Code::Unauthenticated);
    query.attachment.clear();
    assert!(accept(&guard, &query).err().unwrap().contains("no seal"));
    let foreign = guard.key(&name("fleet"), &name("b")).unwrap();
    let forged = accept(&guard, &sealed(&foreign, 7, 2)).err().unwrap();
    assert!(forged.contains("was not made with"), "{forged}");
}

#[test]
fn a_question_that_anybody_may_ask_is_answered_with_a_proof_to_a_vehicle_only() {
    let (guard, key) = guard();
    let query = sealed(&key, 7, 1);
    let question = Seal::decode(&query.attachment).unwrap().tag;
    let tag = guard.question(&query).unwrap().tag(b"answer");
    assert!(key.is_answer(&question, b"answer", &tag));
    let foreign = guard.key(&name("fleet"), &name("b")).unwrap();
    assert!(guard.question(&sealed(&foreign, 7, 1)).is_none());
}

#[test]
fn a_question_with_a_payload_gets_no_proof() {
    let (guard, key) = guard();
    for (payload, proven) in [(vec![], true), (vec![7], false)] {
        let mut query = Recorded::new("egp/v1/r/main/ready", payload);
        let seal = Seal {
            vehicle: (name("fleet"), name("a")),
            run: 7,
            number: 1,
            tag: key.question(&query.key, 7, 1, &query.payload),
        };
        query.attachment = seal.encode();
        let proof = guard.proof(&query, b"answer");
        let timing = proof.map(|bytes| Timing::decode(&*bytes).unwrap());
        let holds = timing.map(|timing| key.is_answer(&seal.tag, b"answer", &timing.tag));
        assert_eq!(holds, proven.then_some(true));
    }
}

#[test]
fn a_request_counts_once_and_the_newest_of_a_run_ends_the_older_ones() {
    let (guard, key) = guard();
    for (number, new) in [
        (5, true),
        (5, false),
        (4, false),
        (6, true),
        (9, true),
        (6, false),
    ] {
        let outcome = accept(&guard, &sealed(&key, 7, number));
        assert_eq!(outcome.is_ok(), new, "number {number}");
        if let Err(reason) = outcome {
            assert!(reason.contains("came before"), "{reason}");
        }
    }
    assert_eq!(guard.twice().get(), 0);
}

#[test]
fn two_clients_with_one_key_are_counted_at_each_turn() {
    let (guard, key) = guard();
    // The second run takes the place of the first, as after a restart of the vehicle.
    for (run, number, twice) in [
        (7, 1, 0),
        (8, 1, 0),
        (8, 2, 0),
        (7, 2, 1),
        (8, 3, 2),
        (8, 4, 2),
    ] {
        assert!(accept(&guard, &sealed(&key, run, number)).is_ok());
        assert_eq!(guard.twice().get(), twice, "run {run}, number {number}");
    }
    // A copy of an old request is no turn.
    assert!(accept(&guard, &sealed(&key, 7, 1)).is_err());
    assert_eq!(guard.twice().get(), 2);
}

#[test]
fn copies_of_many_runs_are_recognised() {
    let (guard, key) = guard();
    for run in 0..1000 {
        assert!(accept(&guard, &sealed(&key, run, 1)).is_ok());
    }
    for run in 0..1000 {
        assert!(accept(&guard, &sealed(&key, run, 1)).is_err());
    }
    assert_eq!(guard.twice().get(), 0);
}

#[test]
fn the_first_of_too_many_runs_is_forgotten() {
    let mut seen = Seen::default();
    for run in 0..4 {
        assert_eq!(seen.note(run, 1, 3), Noted::New);
    }
    assert_eq!((seen.newest.len(), seen.order.len()), (3, 3));
    for run in 1..4 {
        assert_eq!(seen.note(run, 1, 3), Noted::Old);
    }
    assert_eq!(seen.note(0, 1, 3), Noted::New);
}

#[test]
fn the_log_tells_once_a_minute_of_each_vehicle_that_two_clients_have_its_key() {
    let (guard, start) = (guard().0, Instant::now());
    for (vehicle, ms, due) in [
        ("a", 0.0, true),
        ("a", 20.0, false),
        ("b", 20.0, true),
        ("a", 59_999.0, false),
        ("a", 60_000.0, true),
        ("a", 60_020.0, false),
    ] {
        let warns = guard.warns(&name("fleet"), &name(vehicle), at(start, ms));
        assert_eq!(warns, due, "{vehicle} after {ms} ms");
    }
}

#[test]
fn a_file_without_keys_is_an_error_of_the_service() {
    let file = std::env::temp_dir().join(format!("egp-no-keys-{}", std::process::id()));
    std::fs::write(&file, "# fleet/a: nothing yet\n").unwrap();
    let error = Guard::load(&file).err().map(|error| error.to_string());
    std::fs::remove_file(&file).unwrap();
    let error = error.unwrap();
    let named = error.contains("egp-no-keys") && error.contains("no key");
    assert!(named, "{error}");
}

#[test]
fn a_sender_that_does_not_prove_who_it_is_is_told_once_a_minute() {
    let (guard, _) = guard();
    let start = Instant::now();
    let told = [0.0, 59_000.0, 61_000.0, 62_000.0].map(|ms| guard.tells_denial(at(start, ms)));
    assert_eq!(told, [true, false, true, false]);
}
