//! Runs of the simulation, and what they find.
#![allow(clippy::unwrap_used)]

mod routers_and_libraries;
mod simulation;

use std::fs::File;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use egp_simulate::{Config, Run, Scene};

/// The shipped libraries.
fn shipped() -> [PathBuf; 2] {
    let shipped =
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../python/egp_service/shipped");
    ["demo", "evaluation"].map(|name| shipped.join(format!("{name}-library.safetensors")))
}

/// The scene of the shipped libraries.
fn scene() -> Scene {
    let [library, other] = shipped();
    Scene::load(&library, &other).unwrap()
}

/// Some seconds of one vehicle and one replica with the given faults.
fn config(seconds: f64, faults: &[&str]) -> Config {
    Config {
        vehicles: 1,
        replicas: 1,
        seconds,
        recorded: true,
        faults: faults.iter().map(|text| text.parse().unwrap()).collect(),
        ..Config::new(0)
    }
}

/// The times of the lines with this text.
fn times(run: &Run, text: &str) -> Vec<f64> {
    let lines = run.trace.iter().filter(|line| line.contains(text));
    lines
        .map(|line| line.trim().split(' ').next().unwrap().parse().unwrap())
        .collect()
}

#[test]
fn the_program_ends_without_an_error_if_nobody_reads_its_output() {
    let [library, other] = shipped();
    let (reader, closed) = std::io::pipe().unwrap();
    drop(reader);
    let full = File::options().write(true).open("/dev/full").unwrap();
    for (out, code, reason) in [
        (Stdio::from(closed), 0, ""),
        (
            Stdio::from(full),
            2,
            "egp-simulate: cannot write to the standard output",
        ),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_egp-simulate"))
            .args([library.as_os_str(), "--other".as_ref(), other.as_os_str()])
            .args(["--seed", "7", "--seconds", "0.1"])
            .stdout(out)
            .stderr(Stdio::piped())
            .output()
            .unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert!(message.starts_with(reason), "{message}");
        assert!(!message.contains("panicked"), "{message}");
    }
}
