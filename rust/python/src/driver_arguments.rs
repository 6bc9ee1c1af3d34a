//! Arguments of Python that both kinds of drivers take.

use std::collections::BTreeMap;
use std::time::Duration;

use egp_driver::{DriverConfig, Measurement, RunKey};
use egp_wire::KeyRing;
use pyo3::prelude::*;

use crate::array::{fixed, rows};
use crate::error::{InvalidArgumentError, raise};
use crate::gate::configure;

/// The configuration behind both kinds of drivers.
pub fn driver_config(
    fleet: &str,
    vehicle: &str,
    gate: BTreeMap<String, f64>,
    budget: f64,
    hedge: f64,
    want_sigma: bool,
    keys: Option<&str>,
) -> PyResult<DriverConfig> {
    let (limits, max_tail_ticks, stop_deceleration) = configure(gate)?;
    let config = DriverConfig::new(fleet, vehicle, limits).map_err(InvalidArgumentError::raise)?;
    let key = match keys {
        Some(text) => Some(run_key(text, &config)?),
        None => None,
    };
    Ok(DriverConfig {
        budget,
        hedge,
        max_tail_ticks,
        stop_deceleration,
        want_sigma,
        key,
        ..config
    })
}

/// The vehicle's key among those of a text, for a new run.
fn run_key(text: &str, config: &DriverConfig) -> PyResult<RunKey> {
    let ring = KeyRing::parse(text).map_err(InvalidArgumentError::raise)?;
    let key = ring
        .get(&config.fleet, &config.vehicle)
        .map_err(InvalidArgumentError::raise)?;
    Ok(RunKey {
        key: key.clone(),
        run: getrandom::u64().map_err(raise)?,
    })
}

/// Measured state, reference, widths and friction from Python, of which the last two may be `None`. If the state cannot be
/// used, the others are left out whatever they are, because the command is a stop.
pub fn measurement(
    x: &Bound<'_, PyAny>,
    reference: &Bound<'_, PyAny>,
    widths: Option<&Bound<'_, PyAny>>,
    road_friction: Option<&Bound<'_, PyAny>>,
) -> PyResult<Measurement> {
    let unmeasured = Measurement {
        x: fixed("x", &argument("x", x)?)?,
        ..Measurement::default()
    };
    if unmeasured.check_state().is_err() {
        return Ok(unmeasured);
    }
    Ok(Measurement {
        reference: rows("reference", &argument("reference", reference)?)?,
        widths: stated_rows("widths", widths)?,
        road_friction: stated_rows("road_friction", road_friction)?,
        ..unmeasured
    })
}

/// The rows of an argument that may be `None`. An array without rows is an error, because it would count as `None`.
fn stated_rows<const N: usize>(
    name: &str,
    stated: Option<&Bound<'_, PyAny>>,
) -> PyResult<Vec<[f64; N]>> {
    let Some(stated) = stated else {
        return Ok(Vec::new());
    };
    let found = rows(name, &argument(name, stated)?)?;
    if found.is_empty() {
        let reason = "expected a row for each stage, got none; leave it out if nothing is known";
        return Err(InvalidArgumentError::raise(format!("{name}: {reason}")));
    }
    Ok(found)
}

/// An argument as a type, with the note about its name that `PyO3` adds to errors of arguments.
fn argument<'a, 'py, T>(name: &str, value: &'a Bound<'py, PyAny>) -> PyResult<T>
where
    T: FromPyObject<'a, 'py, Error = PyErr>,
{
    value.extract().map_err(|error: PyErr| {
        let noted = error.add_note(value.py(), format!("while processing '{name}'"));
        noted.err().unwrap_or(error)
    })
}

/// Converts a time of the driver's clock, or a part of a period, in s. Errors unless it is from 0 to 1e19 s.
pub fn time(seconds: f64) -> PyResult<Duration> {
    let reason = || format!("expected a time from 0 to 1e19 s, got {seconds}");
    Duration::try_from_secs_f64(seconds).map_err(|_| InvalidArgumentError::new_err(reason()))
}

/// A deadline or budget in s as a time, together with what is measured.
pub fn within(
    deadline: f64,
    measured: impl FnOnce() -> PyResult<Measurement>,
) -> PyResult<(Duration, Measurement)> {
    if !deadline.is_finite() {
        let reason = format!("expected a finite deadline in s, got {deadline}");
        return Err(InvalidArgumentError::new_err(reason));
    }
    Ok((time(deadline)?, measured()?))
}
