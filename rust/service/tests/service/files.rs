//! Files of an operator that are pipes, devices, too large or wrong harm no service that runs, and end one that starts.
#![allow(clippy::unwrap_used, missing_docs)]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use crate::loopback::{
    Client, config, engine, first_request, free_endpoint, library_file, step_key,
};
use crate::operating::{ask, client, free_address, signal, wait_for};
use egp_service::{FetchError, Fetched, Server, ServiceConfig, Wanted};

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

/// A pipe that nobody writes to.
fn pipe(name: &str) -> PathBuf {
    let path = path(name);
    let _ = fs::remove_file(&path);
    let made = Command::new("mkfifo").arg(&path).status();
    assert!(made.unwrap().success());
    path
}

/// What a service says that must end by itself within ten seconds.
fn ended(command: &mut Command) -> Output {
    let mut process = (command.stdout(Stdio::null()).stderr(Stdio::piped()))
        .spawn()
        .unwrap();
    let late = Instant::now() + Duration::from_secs(10);
    while process.try_wait().unwrap().is_none() {
        if Instant::now() > late {
            process.kill().unwrap();
        }
        thread::sleep(Duration::from_millis(20));
    }
    process.wait_with_output().unwrap()
}

#[test]
fn a_limit_of_the_size_of_files_costs_spans_and_ends_no_service() {
    let (endpoint, http, traces) = (free_endpoint(), free_address(), path("limited.jsonl"));
    let _ = fs::remove_file(&traces);
    // 20 blocks of 512 bytes; a request has some 3 kB of spans.
    let mut process = Command::new("sh")
        .args(["-c", "ulimit -f 20; exec \"$@\"", "sh"])
        .arg(env!("CARGO_BIN_EXE_egp-server"))
        .args(["--workers", "1", "--listen", &endpoint, "--library"])
        .arg(library_file("limited.safetensors"))
        .args(["--http", &http.to_string(), "--traces"])
        .arg(&traces)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let client = Client::connect(&endpoint);
    let late = Instant::now() + Duration::from_secs(60);
    let failed = || {
        let (_, metrics) = ask(http, "GET", "/metrics").unwrap();
        let line = metrics
            .lines()
            .find(|line| line.contains("spans_total{outcome=\"failed\"}"));
        line.is_some_and(|line| !line.ends_with(" 0"))
    };
    let mut sequence = 0;
    while !failed() {
        assert!(Instant::now() < late, "no span failed");
        sequence += 1;
        let mut request = first_request();
        request.sequence = sequence;
        client.ask(&step_key("car"), &request.encode());
    }
    assert_eq!(
        ask(http, "GET", "/ready").unwrap(),
        (200, "ready\n".to_owned())
    );
    signal(&process, "-TERM");
    assert!(process.wait().unwrap().success());
    let text = fs::read_to_string(&traces).unwrap();
    assert!(text.is_empty() || text.ends_with('\n'), "{text}");
}

#[test]
fn keys_that_became_a_pipe_leave_a_service_that_can_be_ended() {
    let (endpoint, http, keys) = (free_endpoint(), free_address(), path("live.keys"));
    let _ = fs::remove_file(&keys);
    fs::write(&keys, format!("fleet/car {}\n", "a1".repeat(32))).unwrap();
    let library = library_file("live.safetensors");
    let config = path("live.toml");
    let text = format!(
        "library = {library:?}\nvehicle_keys = {keys:?}\nhttp = \"{http}\"\nlog = \"off\"\n\
         [zenoh]\n\"listen/endpoints\" = '[\"{endpoint}\"]'\n"
    );
    fs::write(&config, text).unwrap();
    let mut process = Command::new(env!("CARGO_BIN_EXE_egp-server"))
        .arg("--config")
        .arg(&config)
        .spawn()
        .unwrap();
    wait_for(http, "/ready", "ready\n");
    pipe("live.keys");
    signal(&process, "-HUP");
    wait_for(
        http,
        "/metrics",
        "egp_key_reloads_total{outcome=\"failed\"} 1",
    );
    wait_for(http, "/metrics", "egp_reloads_total{outcome=\"same\"} 1");
    signal(&process, "-TERM");
    assert!(process.wait().unwrap().success());
}

#[test]
fn a_start_waits_for_no_pipe_and_reads_no_device() {
    let library = library_file("pipes.safetensors");
    let pipe = pipe("start.pipe");
    for key in ["vehicle_keys", "library_keys", "zenoh_file"] {
        let config = path("pipes.toml");
        fs::write(
            &config,
            format!("library = {library:?}\n{key} = {pipe:?}\n"),
        )
        .unwrap();
        for option in ["--check", "--watch"] {
            let mut command = Command::new(env!("CARGO_BIN_EXE_egp-server"));
            let output = ended(command.arg(option).arg("--config").arg(&config));
            let message = String::from_utf8(output.stderr).unwrap();
            assert_eq!(output.status.code(), Some(1), "{message}");
            assert!(
                message.contains("start.pipe: expected a regular file"),
                "{message}"
            );
        }
    }
    for file in [pipe.as_path(), Path::new("/dev/zero")] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_egp-server"));
        let output = ended(command.arg("--config").arg(file));
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(
            message.contains("cannot read the configuration"),
            "{message}"
        );
    }
}

#[test]
fn a_mistake_in_a_configuration_names_the_file() {
    let config = path("mistake.toml");
    let long = "x".repeat(100_000);
    fs::write(&config, format!("libary = \"{long}\"\n")).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_egp-server"));
    let output = ended(command.arg("--config").arg(&config));
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(
        message.contains("mistake.toml: the configuration"),
        "{message}"
    );
    assert!(message.len() < 3000, "{message}");
}

/// What a process logs until a line has these words, and for the time `after` from then on. Panics if no line has them within a
/// minute.
fn log_until(command: &mut Command, words: &str, after: Duration) -> String {
    let mut process = command.stderr(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(process.stderr.take().unwrap()).lines();
    let (told, heard) = mpsc::channel();
    let reading = thread::spawn(move || {
        for line in lines.map_while(Result::ok) {
            let _ = told.send(line);
        }
    });
    let (late, mut log) = (Instant::now() + Duration::from_secs(60), String::new());
    while !log.contains(words) {
        match heard.recv_timeout(late.saturating_duration_since(Instant::now())) {
            Ok(line) => log += &(line + "\n"),
            Err(_) => break,
        }
    }
    let found = log.contains(words);
    thread::sleep(if found { after } else { Duration::ZERO });
    process.kill().unwrap();
    process.wait().unwrap();
    reading.join().unwrap();
    log.extend(heard.iter().map(|line| line + "\n"));
    assert!(found, "{words} is not in: {log}");
    log
}

#[test]
fn the_log_is_not_filled_while_a_service_waits_for_its_router() {
    let default = ServiceConfig::new("").log;
    let mut command = client(
        "quiet.safetensors",
        &free_endpoint(),
        free_address(),
        &default,
    );
    let words = "no session yet; trying again";
    let log = log_until(&mut command, words, Duration::from_secs(3));
    assert!(log.lines().count() < 8, "{log}");
}

#[test]
fn endpoints_that_nobody_answers_are_named() {
    let (listen, gone) = (free_endpoint(), free_endpoint());
    let mut command = Command::new(env!("CARGO_BIN_EXE_egp-server"));
    command
        .args(["--listen", &listen, "--connect", &gone, "--library"])
        .arg(library_file("alone.safetensors"));
    let words = "nobody answers at connect/endpoints";
    let log = log_until(&mut command, words, Duration::from_secs(1));
    let told: Vec<_> = log.lines().filter(|line| line.contains(words)).collect();
    assert!(told.len() == 1 && told[0].contains(&gone), "{log}");
}

/// Fetches the library with this number as all bytes of its hash from the replica at an endpoint.
fn fetch(file: &Path, number: u8, endpoint: &str) -> Result<Fetched, FetchError> {
    let mut network = ServiceConfig::new("unused");
    let endpoints = format!("[\"{endpoint}\"]");
    (network.zenoh).insert("connect/endpoints".to_owned(), endpoints);
    let wanted = Wanted {
        id: [number; 32],
        file,
        keys: None,
    };
    wanted.fetch(&network, Duration::from_secs(60), &mut || false)
}

#[test]
fn what_every_replica_lacks_is_not_waited_for() {
    let endpoint = free_endpoint();
    let server = Server::start_with(&config(&endpoint), engine()).unwrap();
    Client::connect(&endpoint);
    let begun = Instant::now();
    let error = fetch(&path("lacking.safetensors"), 7, &endpoint).unwrap_err();
    assert!(matches!(error, FetchError::Failed { .. }), "{error}");
    assert!(
        begun.elapsed() < Duration::from_secs(20),
        "{:?}",
        begun.elapsed()
    );
    server.drain();
}

#[test]
fn nothing_is_fetched_in_place_of_a_pipe() {
    let pipe = pipe("fetched.pipe");
    let begun = Instant::now();
    let error = fetch(&pipe, 7, &free_endpoint()).unwrap_err().to_string();
    assert!(
        error.contains("fetched.pipe: expected a regular file or a new name"),
        "{error}"
    );
    assert!(begun.elapsed() < Duration::from_secs(5));
}
