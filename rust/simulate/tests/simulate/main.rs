//! Runs of the simulation, and what they find.
#![allow(clippy::unwrap_used, clippy::panic)]

mod command;
mod fleet_map;
mod planted;
mod routers_and_libraries;
mod simulation;

use std::path::PathBuf;
use std::process::Command;

use egp_simulate::{Config, Run, Scene};
use egp_testing::outputs::without_output;

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
    without_output("egp-simulate", 2, || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_egp-simulate"));
        command
            .args([library.as_os_str(), "--other".as_ref(), other.as_os_str()])
            .args(["--seed", "7", "--seconds", "0.1"]);
        command
    });
}
