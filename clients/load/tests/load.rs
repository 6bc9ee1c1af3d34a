//! A short load test of a real service: the counts must add up.
#![allow(clippy::unwrap_used, missing_docs)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

use egp_service::{Server, ServiceConfig};
use egp_testing::outputs::{interrupted, without_output};
use egp_testing::ports::free_endpoint;
use serde_json::Value;

const LIBRARY: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../python/egp_service/shipped/demo-library.safetensors"
);

/// A service of the demo's library with a changed configuration, and its endpoint.
fn serve(change: impl FnOnce(&mut ServiceConfig)) -> (Server, String) {
    let endpoint = free_endpoint();
    let mut config = ServiceConfig::new(LIBRARY);
    config
        .zenoh
        .insert("listen/endpoints".to_owned(), format!("[\"{endpoint}\"]"));
    change(&mut config);
    (Server::start(&config).unwrap(), endpoint)
}

/// Loads a service with one vehicle and these further options.
fn load(endpoint: &str, options: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_egp-load"))
        .args(["--connect", endpoint, "--vehicles", "1"])
        .args(options)
        .output()
        .unwrap()
}

#[test]
fn every_due_request_is_accounted_for() {
    let (server, endpoint) = serve(|_| {});
    let json = concat!(env!("CARGO_TARGET_TMPDIR"), "/load.json");
    let output = Command::new(env!("CARGO_BIN_EXE_egp-load"))
        .args([
            "--connect",
            &endpoint,
            "--vehicles",
            "2",
            "--seconds",
            "2",
            "--warm-up",
            "0.5",
        ])
        .args(["--json", json])
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.contains("latency from due time"), "{table}");
    let report: Value = serde_json::from_slice(&fs::read(json).unwrap()).unwrap();
    let number = |name: &str| report[name].as_f64().unwrap();
    // Two vehicles, 50 requests a second each, for two seconds, on a schedule that nothing delays.
    assert_eq!(number("requests"), 200.0, "{table}");
    let outcomes: f64 = report["outcomes"]
        .as_object()
        .unwrap()
        .values()
        .map(|n| n.as_f64().unwrap())
        .sum();
    assert_eq!(outcomes, 200.0, "{table}");
    let solved = report["outcomes"]["solved"].as_f64().unwrap_or(0.0);
    assert_eq!(number("misses"), 200.0 - solved, "{table}");
    let commands: f64 = [
        "normal_periods",
        "tail_periods",
        "stop_periods",
        "waiting_periods",
    ]
    .map(number)
    .iter()
    .sum();
    assert_eq!(commands, 200.0, "{table}");
    assert!(solved > 0.0, "{table}");
    server.drain();
}

#[test]
fn a_service_for_another_vehicle_is_told_from_one_that_is_not_there() {
    let (server, endpoint) = serve(|config| config.settings.mass = Some(1284.0));
    let output = load(&endpoint, &[]);
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(told.contains("has 1284 kg"), "{told}");
    assert!(told.contains("egp load --replay run.mcap"), "{told}");
    assert!(!told.contains("is the service running there"), "{told}");
    server.drain();
}

#[test]
fn a_service_that_needs_keys_is_told_from_one_that_is_not_there() {
    let keys = Path::new(env!("CARGO_TARGET_TMPDIR")).join("load.keys");
    fs::write(&keys, format!("load/car-0 {}\n", "a1".repeat(32))).unwrap();
    let (server, endpoint) = serve(|config| config.vehicle_keys = Some(keys));
    let output = load(&endpoint, &[]);
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("only vehicles with a secret key"), "{told}");
    assert!(told.contains("load/car-0 and so on with --key"), "{told}");
    server.drain();
}

#[test]
fn a_measurement_without_a_plan_fails_and_says_why() {
    let (server, endpoint) = serve(|_| {});
    // The budget is 20 µs, in which no answer can come.
    let options = ["--seconds=1", "--warm-up=0.1", "--budget=0.001"];
    let output = load(&endpoint, &options);
    let (table, told) = (
        String::from_utf8(output.stdout).unwrap(),
        String::from_utf8(output.stderr).unwrap(),
    );
    assert_eq!(output.status.code(), Some(1), "{told}");
    let step = table.lines().find(|line| line.contains("in the step"));
    let dashes = format!("{:24}{}{:9}", "  in the step", "        -".repeat(4), 0);
    assert_eq!(step, Some(dashes.as_str()), "{table}");
    assert!(told.contains("no request was solved"), "{told}");
    assert!(told.contains("ended with `late`"), "{told}");
    assert!(told.contains("raise --budget"), "{told}");
    server.drain();
}

#[test]
fn an_interrupted_measurement_is_reported() {
    let (server, endpoint) = serve(|_| {});
    let mut command = Command::new(env!("CARGO_BIN_EXE_egp-load"));
    command
        .args(["--connect", &endpoint, "--vehicles", "1"])
        .args(["--seconds", "600", "--warm-up", "0"]);
    let output = interrupted(&mut command, Duration::from_secs(1));
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(130), "{told}");
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.contains("latency from due time"), "{table}");
    assert!(table.contains("(50.0 a second)"), "{table}");
    server.drain();
}

#[test]
fn a_measurement_takes_time() {
    for (option, value) in [
        ("seconds", "0"),
        ("seconds", "-1"),
        ("seconds", "NaN"),
        ("seconds", "1e19"),
        ("warm-up", "-1"),
        ("warm-up", "1e19"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_egp-load"))
            .arg(format!("--{option}={value}"))
            .output()
            .unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains("to 86400"), "{message}");
    }
}

#[test]
fn a_folder_in_place_of_the_report_is_an_error_before_the_measurement() {
    let output = Command::new(env!("CARGO_BIN_EXE_egp-load"))
        .args(["--json", env!("CARGO_TARGET_TMPDIR")])
        .output()
        .unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        told.contains("cannot write the report") && told.contains("is a directory"),
        "{told}"
    );
}

#[test]
fn an_error_that_nobody_reads_ends_the_program_like_any_other() {
    let (reader, told) = std::io::pipe().unwrap();
    drop(reader);
    let status = Command::new(env!("CARGO_BIN_EXE_egp-load"))
        .args(["--json", env!("CARGO_TARGET_TMPDIR")])
        .stderr(told)
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(1));
}

#[test]
fn the_usage_asks_for_no_option_that_has_a_default() {
    let output = Command::new(env!("CARGO_BIN_EXE_egp-load"))
        .arg("--nonsense")
        .output()
        .unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(told.contains("egp-load [OPTIONS]\n"), "{told}");
}

#[test]
fn the_report_is_kept_although_nobody_reads_the_result() {
    let (_server, endpoint) = serve(|_| {});
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let mut reports = ["closed.json", "full.json"]
        .map(|name| folder.join(name))
        .into_iter();
    let written = reports.clone();
    without_output("egp-load", 1, || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_egp-load"));
        command
            .args(["--connect", &endpoint, "--vehicles", "1"])
            .args(["--seconds", "0.1", "--warm-up", "0", "--json"])
            .arg(reports.next().unwrap());
        command
    });
    for json in written {
        let report: Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
        assert_eq!(report["requests"], 5, "{report}");
        fs::remove_file(json).unwrap();
    }
}
