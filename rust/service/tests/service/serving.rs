//! The answers of a replica that works normally.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

use crate::loopback::{
    Client, Outcome, config, engine, free_endpoint, library_file, request, step_key,
};
use egp_driver::Carry;
use egp_service::{Server, check};
use egp_wire::{Load, Ready, Reply, Status, keys};
use prost::Message as _;
use zenoh::Wait;

#[test]
fn replies_are_the_engines_bits_with_timings_beside_them() {
    let endpoint = free_endpoint();
    let server = Server::start_with(&config(&endpoint), engine()).unwrap();
    let client = Client::connect(&endpoint);
    let local = engine();
    let mut workspace = local.workspace().unwrap();
    let mut carry = Carry::new(local.library().id(), 10);
    for _ in 0..5 {
        let mut request = request(&mut carry);
        request.want_sigma = true;
        let bytes = request.encode();
        let Outcome::Answer { payload, timing } = client.ask(&step_key("car"), &bytes) else {
            panic!("no answer");
        };
        let mut expected = Vec::new();
        local.step(&mut workspace, &bytes, &mut expected).unwrap();
        assert!(payload == expected, "bits differ");
        assert!(timing.unwrap().step_us > 0);
        let reply = Reply::decode(&payload).unwrap();
        assert_eq!((reply.status, reply.sigma.len()), (Status::Solved, 21));
        carry.accept(&reply);
    }
    server.drain();
}

#[test]
fn a_replica_tells_what_it_serves_and_how_it_fares() {
    let endpoint = free_endpoint();
    let server = Server::start_with(&config(&endpoint), engine()).unwrap();
    let client = Client::connect(&endpoint);
    client.ask(&step_key("car"), &crate::loopback::first_request().encode());
    let text = |key: String| match client.ask(&key, &[]) {
        Outcome::Answer { payload, .. } => payload,
        other => panic!("{key}: {other:?}"),
    };
    let main = "main".parse().unwrap();
    assert_eq!(text(keys::health(&main)), b"ok");
    let ready = Ready::decode(&text(keys::ready(&main))).unwrap();
    assert_eq!(ready, engine().describe());
    assert_eq!(
        Ready::decode(&text("egp/v1/r/*/ready".to_owned())).unwrap(),
        ready
    );
    let metrics = String::from_utf8(text(keys::metrics(&main))).unwrap();
    for line in [
        "egp_requests_total{outcome=\"solved\"} 1",
        "egp_step_seconds_count 1",
        "egp_queue_seconds_count 1",
        "egp_panics_total 0",
        "egp_queued 0",
        "# EOF",
    ] {
        assert!(
            metrics.lines().any(|found| found == line),
            "{line} not in\n{metrics}"
        );
    }
    let load = client
        .session
        .declare_subscriber(keys::load(&main))
        .wait()
        .unwrap();
    let load = Load::decode(&*load.recv().unwrap().payload().to_bytes()).unwrap();
    assert!(load.workers == 2 && load.queued == 0 && load.step_us > 0);
    server.drain();
    client.wait_until_alive(false);
}

#[test]
fn a_check_finds_what_would_prevent_a_start() {
    let library = library_file("check.safetensors");
    let busy = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let mut good = config(&format!("tcp/{}", busy.local_addr().unwrap()));
    good.library = library;
    // The port may be that of the service that runs already.
    assert_eq!(check(&good).unwrap().served.members.len(), 2);
    let zenoh = |key: &str, value: &str| {
        let mut bad = good.clone();
        bad.zenoh.insert(key.to_owned(), value.to_owned());
        bad
    };
    let (mut log, mut file, mut pipe) = (good.clone(), good.clone(), good.clone());
    log.log = "egp_service=loud".to_owned();
    file.zenoh_file = Some("nowhere.json5".into());
    pipe.library = "/dev/null".into();
    for (bad, reason) in [
        (log, "log filter"),
        (file, "zenoh file nowhere.json5"),
        (pipe, "expected a regular file"),
        (zenoh("no/such/key", "3"), "no/such/key"),
        (zenoh("listen/endpoints", "['bogus']"), "bogus"),
        (zenoh("listen/endpoints", "['quic/127.0.0.1:1']"), "quic"),
        (zenoh("listen/endpoints", "['tls/127.0.0.1:1']"), "egp keys"),
        (
            zenoh("transport/link/tls/root_ca_certificate", "'nowhere.pem'"),
            "root_ca_certificate nowhere.pem",
        ),
    ] {
        let message = check(&bad).unwrap_err().to_string();
        assert!(message.contains(reason), "{reason}: {message}");
    }
}

#[test]
fn without_library_and_configuration_both_are_named() {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_egp-server"))
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(
        told.contains("<--library <LIBRARY>|--config <CONFIG>>"),
        "{told}"
    );
}
