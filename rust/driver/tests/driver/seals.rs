//! With a key, only answers of a service that has the same key have an effect.

use egp_driver::{Discovery, Driver, DriverConfig, Outcome, Query, RunKey};
use egp_gate::Mode;
use egp_wire::{Code, Invalid, KeyRing, Seal, Timing, VehicleKey};
use prost::Message as _;

use crate::world::{
    PERIOD, appear, asked, config, decided, error, ms, name, probed, served, solved, tick,
};

fn key(digits: &str) -> VehicleKey {
    let text = format!("depot/car-7 {}", digits.repeat(32));
    let ring = KeyRing::parse(&text).unwrap();
    ring.get(&name("depot"), &name("car-7")).unwrap().clone()
}

fn driver(replicas: &[&str]) -> Driver {
    let key = Some(RunKey {
        key: key("1f"),
        run: 77,
    });
    let config = DriverConfig { key, ..config() };
    let mut driver = Driver::new(config, served()).unwrap();
    for replica in replicas {
        appear(&mut driver, &name(replica));
    }
    driver
}

/// What a service with this key attaches to an answer.
fn attached(key: &VehicleKey, query: &Query, answer: &[u8]) -> Vec<u8> {
    let seal = Seal::decode(&query.attachment).unwrap();
    let tag = key.answer(&seal.tag, answer).to_vec();
    Timing {
        step_us: 250,
        tag,
        ..Timing::default()
    }
    .encode_to_vec()
}

#[test]
fn questions_are_sealed_and_answers_with_the_tag_are_used() {
    let mut driver = driver(&["a"]);
    let mut seals = Vec::new();
    for period in 1..=3 {
        tick(&mut driver, PERIOD * period);
        let query = asked(&mut driver);
        let seal = Seal::decode(&query.attachment).unwrap();
        assert!(key("1f").is_question(&query.key, &seal, &query.payload));
        let reply = solved(&query).encode();
        let own = attached(&key("1f"), &query, &reply);
        driver.replied(PERIOD * period, query.id, &reply, &own);
        let step = decided(&mut driver);
        assert!(step.outcome.is_solved());
        assert_eq!(step.timing.unwrap().step_us, 250);
        seals.push(seal);
    }
    assert!(seals.windows(2).all(|pair| pair[0].number < pair[1].number));
}

#[test]
fn forged_replayed_and_swapped_answers_are_never_driven_and_the_true_one_still_is() {
    let mut driver = driver(&["a"]);
    tick(&mut driver, ms(20));
    let first = asked(&mut driver);
    let old = solved(&first).encode();
    let old_attachment = attached(&key("1f"), &first, &old);
    driver.replied(ms(21), first.id, &old, &old_attachment);
    decided(&mut driver);
    tick(&mut driver, ms(40));
    let query = asked(&mut driver);
    let reply = solved(&query).encode();
    for (payload, attachment) in [
        (&reply, vec![]),                               // without a tag
        (&reply, attached(&key("2f"), &query, &reply)), // by somebody with another key
        (&reply, attached(&key("1f"), &query, &old)),   // the tag of another reply
        (&reply, attached(&key("1f"), &first, &reply)), // of another question
        (&old, old_attachment.clone()),                 // recorded before
    ] {
        driver.replied(ms(41), query.id, payload, &attachment);
        assert!(driver.next_action().is_none());
    }
    driver.replied(
        ms(42),
        query.id,
        &reply,
        &attached(&key("1f"), &query, &reply),
    );
    assert!(decided(&mut driver).outcome.is_solved());
}

#[test]
fn a_period_with_forged_answers_only_is_bridged_and_says_why() {
    let mut driver = driver(&["a", "b"]);
    tick(&mut driver, ms(20));
    for _ in 0..2 {
        let query = asked(&mut driver);
        driver.replied(ms(21), query.id, &solved(&query).encode(), b"");
        driver.ended(ms(21), query.id);
    }
    let step = decided(&mut driver);
    assert_eq!((step.asked, step.command.mode), (2, Mode::Waiting));
    assert!(matches!(
        step.outcome,
        Outcome::Unusable(Invalid::Field { field: "tag", .. })
    ));
}

#[test]
fn an_error_that_anybody_can_send_does_not_keep_the_answer_out() {
    let mut driver = driver(&["a"]);
    tick(&mut driver, ms(20));
    let query = asked(&mut driver);
    driver.refused(ms(21), query.id, &error(Code::Internal));
    decided(&mut driver); // there is no other replica
    let reply = solved(&query).encode();
    driver.replied(
        ms(22),
        query.id,
        &reply,
        &attached(&key("1f"), &query, &reply),
    );
    tick(&mut driver, ms(40));
    let next = asked(&mut driver);
    driver.ended(ms(41), next.id);
    let step = decided(&mut driver);
    assert_eq!((step.late.len(), step.command.mode), (1, Mode::Tail));
}

/// Two routers deliver a question twice; a service with keys answers the second copy with `UNAUTHENTICATED`.
#[test]
fn a_copy_that_came_before_demotes_nobody() {
    let mut driver = driver(&["a", "b"]);
    tick(&mut driver, ms(20));
    let query = asked(&mut driver);
    driver.refused(ms(21), query.id, &error(Code::Unauthenticated));
    assert!(driver.next_action().is_none());
    let reply = solved(&query).encode();
    let own = attached(&key("1f"), &query, &reply);
    driver.replied(ms(22), query.id, &reply, &own);
    assert_eq!(decided(&mut driver).asked, 1);
    driver.ended(ms(23), query.id);
    tick(&mut driver, ms(40));
    let next = asked(&mut driver);
    assert_eq!(next.replica, query.replica);
    // The vehicle's key is not that of the service: the question ends without a reply.
    driver.refused(ms(41), next.id, &error(Code::Unauthenticated));
    driver.ended(ms(41), next.id);
    assert_ne!(asked(&mut driver).replica, next.replica);
    tick(&mut driver, ms(60));
    assert_ne!(asked(&mut driver).replica, next.replica);
}

#[test]
fn the_end_of_a_query_that_was_answered_with_an_error_is_no_further_failure() {
    let mut driver = driver(&["a", "b"]);
    tick(&mut driver, ms(20));
    let first = asked(&mut driver);
    driver.refused(ms(21), first.id, &error(Code::Internal));
    let second = asked(&mut driver);
    driver.refused(ms(22), second.id, &error(Code::Internal));
    decided(&mut driver);
    tick(&mut driver, ms(40));
    let query = asked(&mut driver);
    assert_eq!(query.replica, first.replica);
    let reply = solved(&query).encode();
    let own = attached(&key("1f"), &query, &reply);
    driver.replied(ms(41), query.id, &reply, &own);
    decided(&mut driver);
    driver.ended(ms(50), first.id);
    tick(&mut driver, ms(60));
    assert_eq!(asked(&mut driver).replica, first.replica);
}

#[test]
fn questions_of_a_discovery_have_numbers_apart_from_those_of_its_driver() {
    let key = Some(RunKey {
        key: key("1f"),
        run: 77,
    });
    let mut discovery = Discovery::new(&DriverConfig { key, ..config() }).unwrap();
    for replica in ["a", "b"] {
        discovery.replica_appeared(name(replica));
    }
    for number in [(1 << 63) + 1, (1 << 63) + 2] {
        let question = discovery.next_question().unwrap();
        assert_eq!(Seal::decode(&question.attachment).unwrap().number, number);
    }
}

#[test]
fn a_probe_is_passed_with_the_tag_only() {
    let mut driver = driver(&["a", "b"]);
    tick(&mut driver, ms(20));
    let failed = asked(&mut driver);
    driver.wake(ms(36));
    decided(&mut driver);
    tick(&mut driver, ms(1036));
    let probe = probed(&mut driver);
    let seal = Seal::decode(&probe.attachment).unwrap();
    assert!(key("1f").is_question(&probe.key, &seal, &[]));
    asked(&mut driver);
    let description = served().encode();
    driver.replied(ms(1037), probe.id, &description, b"");
    tick(&mut driver, ms(1056));
    assert_ne!(asked(&mut driver).replica, failed.replica);
    let own = attached(&key("1f"), &probe, &description);
    driver.replied(ms(1056), probe.id, &description, &own);
    tick(&mut driver, ms(1076));
    assert_eq!(asked(&mut driver).replica, failed.replica);
}
