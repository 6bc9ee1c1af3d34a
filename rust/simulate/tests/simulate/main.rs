//! Runs of the simulation, and what they find.
#![allow(clippy::unwrap_used)]

mod routers_and_libraries;
mod simulation;

use std::path::PathBuf;

use egp_simulate::{Config, Run, Scene};

/// The scene of the shipped libraries.
fn scene() -> Scene {
    let shipped =
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../python/egp_service/shipped");
    Scene::load(
        &shipped.join("demo-library.safetensors"),
        &shipped.join("evaluation-library.safetensors"),
    )
    .unwrap()
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
