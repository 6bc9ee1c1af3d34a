//! A replica that drains answers every request that reaches it.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::time::Duration;

use crate::loopback::{
    Client, Outcome, Watched, config, engine, first_request, free_endpoint, library_file, step_key,
};
use egp_service::{ReloadError, Server};
use egp_wire::keys;
use zenoh::{Wait, sample::SampleKind};

#[test]
fn no_query_sent_while_the_replica_is_announced_stays_unanswered() {
    let endpoint = free_endpoint();
    let mut config = config(&endpoint);
    config.drain_ms = 1000; // a client that gets no processor time hears of the withdrawal later
    let server = Server::start_with(&config, engine()).unwrap();
    let vehicles: Vec<_> = (0..4)
        .map(|vehicle| {
            let (client, announced) = (Client::connect(&endpoint), Arc::new(AtomicBool::new(true)));
            let seen = announced.clone();
            let withdrawn = client
                .session
                .liveliness()
                .declare_subscriber(keys::ALL_LIVE)
                .callback(move |sample| {
                    if sample.kind() == SampleKind::Delete {
                        seen.store(false, Ordering::Release);
                    }
                })
                .wait()
                .unwrap();
            let (key, bytes) = (step_key(&format!("car{vehicle}")), first_request().encode());
            std::thread::spawn(move || {
                let _withdrawn = withdrawn;
                let mut answered = 0;
                while announced.load(Ordering::Acquire) {
                    let outcome = client.ask(&key, &bytes);
                    assert_ne!(outcome, Outcome::Empty, "after {answered} answers");
                    answered += 1;
                }
                answered
            })
        })
        .collect();
    std::thread::sleep(Duration::from_millis(500));
    server.drain();
    let answered: u32 = vehicles
        .into_iter()
        .map(|vehicle| vehicle.join().unwrap())
        .sum();
    assert!(answered > 20, "only {answered} answers");
}

/// Notes that it is dropped, with the engine that holds it.
struct Ended(Arc<AtomicBool>);

impl Drop for Ended {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

#[test]
fn a_service_that_is_dropped_ends_its_steps_and_threads_before() {
    let endpoint = free_endpoint();
    let ((begun, steps), ended) = (channel(), Arc::new(AtomicBool::new(false)));
    let last = Ended(ended.clone());
    let slow = Watched {
        engine: engine(),
        before: move |sequence| {
            assert!(!last.0.load(Ordering::Acquire));
            begun.send(sequence).unwrap();
            std::thread::sleep(Duration::from_millis(300));
        },
    };
    let server = Server::start_with(&config(&endpoint), slow).unwrap();
    assert!(matches!(server.reload(), Err(ReloadError::NoFile)));
    let client = Client::connect(&endpoint);
    let answer = client.start(&step_key("car"), &first_request().encode());
    steps.recv().unwrap();
    drop(server);
    assert!(ended.load(Ordering::Acquire));
    assert!(matches!(answer(), Outcome::Answer { .. }));
}

#[test]
fn the_process_serves_and_drains_on_sigterm() {
    let endpoint = free_endpoint();
    let library = library_file("draining.safetensors");
    let config = library.with_extension("toml");
    let text = format!("library = {library:?}\n[settings]\nhorizon = 20\n");
    std::fs::write(&config, text).unwrap();
    let mut process = Command::new(env!("CARGO_BIN_EXE_egp-server"))
        .args([
            "--log-json",
            "--workers",
            "1",
            "--listen",
            &endpoint,
            "--config",
        ])
        .arg(&config)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let client = Client::connect(&endpoint);
    let outcome = client.ask(&step_key("car"), &first_request().encode());
    assert!(matches!(outcome, Outcome::Answer { .. }), "{outcome:?}");
    let pid = process.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-TERM", &pid])
            .status()
            .unwrap()
            .success()
    );
    assert!(process.wait().unwrap().success());
    let log = BufReader::new(process.stderr.take().unwrap());
    let last = log.lines().last().unwrap().unwrap();
    assert!(last.starts_with('{') && last.contains("drained"), "{last}");
}

#[test]
fn the_process_refuses_a_bad_start_in_words() {
    for (arguments, words) in [
        (
            ["--library", "missing.safetensors"],
            "cannot read the library missing.safetensors",
        ),
        (
            ["--config", "missing.toml"],
            "cannot read the configuration missing.toml",
        ),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_egp-server"))
            .args(arguments)
            .output()
            .unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(
            !output.status.success() && message.contains(words),
            "{message}"
        );
    }
}
