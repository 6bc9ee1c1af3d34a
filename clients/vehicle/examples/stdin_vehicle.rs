//! A vehicle whose control periods come as JSON lines on standard input, for the conformance suite in
//! `tests/conformance`. Its arguments are the seconds in which it must have connected, and the endpoints.
//!
//! It first writes what is served, or why it cannot connect. Then `{"deadline": s, "x": [7], "reference": [[4], ...]}` opens
//! a period, `{"reset": true}` resets, and `{"replicas": true}` asks how many replicas announce themselves. Each line is
//! answered by one line.

use std::error::Error;
use std::io::{BufRead as _, Write as _, stdin, stdout};
use std::time::{Duration, Instant};

use egp_vehicle::{GateLimits, Measurement, Step, VehicleClient, VehicleConfig, VehicleParameters};
use serde::Deserialize;
use serde_json::{Value, json};

/// One line of input.
#[derive(Deserialize)]
#[serde(untagged, deny_unknown_fields)]
enum Command {
    Step {
        deadline: f64,
        x: [f64; 7],
        reference: Vec<[f64; 4]>,
    },
    Reset {
        #[serde(rename = "reset")]
        _reset: bool,
    },
    Replicas {
        #[serde(rename = "replicas")]
        _replicas: bool,
    },
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (patience, endpoints) = arguments.split_first().ok_or("no patience was stated")?;
    let endpoints: Vec<&str> = endpoints.iter().map(String::as_str).collect();
    let limits = GateLimits::of(&VehicleParameters::FORD_ESCORT);
    let mut config = VehicleConfig::new("conformance", "car", limits, &endpoints)?;
    config.driver.max_tail_ticks = Some(5);
    config.patience = Duration::try_from_secs_f64(patience.parse()?)?;
    let mut vehicle = match VehicleClient::connect(&config) {
        Ok(vehicle) => vehicle,
        Err(error) => return answer(&json!({ "error": error.to_string() })),
    };
    answer(&json!({ "dt": vehicle.dt(), "horizon": vehicle.horizon() }))?;
    for line in stdin().lock().lines() {
        match serde_json::from_str(&line?)? {
            Command::Reset { .. } => {
                vehicle.reset();
                answer(&json!({}))?;
            }
            Command::Replicas { .. } => answer(&json!({ "replicas": vehicle.replicas().len() }))?,
            Command::Step {
                deadline,
                x,
                reference,
            } => {
                let due = Instant::now() + Duration::try_from_secs_f64(deadline)?;
                let measurement = Measurement {
                    x,
                    reference,
                    ..Measurement::default()
                };
                match vehicle.step_by(due, measurement) {
                    Ok(step) => answer(&describe(&step, vehicle.weights()))?,
                    Err(error) => answer(&json!({ "error": error.to_string() }))?,
                }
            }
        }
    }
    Ok(())
}

fn describe(step: &Step, weights: &[f64]) -> Value {
    json!({
        "mode": step.command.mode.name(),
        "status": step.outcome.name(),
        "replica": step.replica.as_ref().map_or_else(String::new, ToString::to_string),
        "lost": step.lost.is_some(),
        "u": step.command.u,
        "weights": weights,
        "request": step.request,
    })
}

fn answer(value: &Value) -> Result<(), Box<dyn Error>> {
    let mut out = stdout().lock();
    writeln!(out, "{value}")?;
    Ok(out.flush()?)
}
