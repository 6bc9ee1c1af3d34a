//! The gate in front of the actuators.

use std::collections::BTreeMap;

use egp_gate::{GateError, Limits};
use pyo3::prelude::*;

use crate::error::{InvalidArgumentError, raise};

/// The command of one period.
#[pyclass(frozen, get_all, module = "egp_service._core.testing")]
#[derive(Clone)]
pub struct Command {
    /// Force [N] and steering rate [rad/s].
    u: (f64, f64),
    /// The mode of the gate: "normal", "tail", "stop" or "waiting".
    mode: &'static str,
    /// Whether a limit changed the command of the plan.
    limited: bool,
}

/// WAITING (brakes) → NORMAL → TAIL (rest of the last plan) → STOP (brakes, latched).
///
/// Every command lies inside hard limits of value and slew. Periods have `dt` s. `settings` holds all limits, as
/// `VehicleParameters.gate_limits` gives them, and may hold `max_tail_ticks` (half a second) and `stop_deceleration`
/// (3 m/s², or the strongest that the limits allow).
/// Raises `InvalidArgumentError` for a limit that is missing or has the wrong sign, and for an unknown name.
#[pyclass(module = "egp_service._core.testing")]
pub struct Gate(egp_gate::Gate);

/// Limits, tail in periods (none for the default) and deceleration of a gate, m/s². All limits must be stated; unknown names
/// are errors.
pub fn configure(mut settings: BTreeMap<String, f64>) -> PyResult<(Limits, Option<u64>, f64)> {
    let max_tail_ticks = settings.remove("max_tail_ticks");
    let stop_deceleration = settings.remove("stop_deceleration");
    let mut limit = |name: &str| {
        settings.remove(name).ok_or_else(|| {
            InvalidArgumentError::new_err(format!(
                "gate limit {name} is missing; `VehicleParameters.gate_limits()` gives a vehicle's"
            ))
        })
    };
    let limits = Limits {
        mass: limit("mass")?,
        force_min: limit("force_min")?,
        force_max: limit("force_max")?,
        power: limit("power")?,
        force_slew: limit("force_slew")?,
        steering_angle: limit("steering_angle")?,
        steering_rate: limit("steering_rate")?,
        steering_slew: limit("steering_slew")?,
    };
    if let Some(name) = settings.keys().next() {
        return Err(InvalidArgumentError::new_err(format!(
            "unknown gate setting {name:?}; known: mass, force_min, force_max, power, force_slew, \
             steering_angle, steering_rate, steering_slew, max_tail_ticks, stop_deceleration"
        )));
    }
    if let Some(ticks) = max_tail_ticks
        && (!(0.0..=1e6).contains(&ticks) || ticks.fract() != 0.0)
    {
        return Err(InvalidArgumentError::new_err(format!(
            "gate setting max_tail_ticks must be a whole number from 0 to 1000000, got {ticks}"
        )));
    }
    // The number is whole, not negative and small by the check above.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    Ok((
        limits,
        max_tail_ticks.map(|ticks| ticks as u64),
        stop_deceleration.unwrap_or_else(|| limits.stop_deceleration()),
    ))
}

#[pymethods]
impl Gate {
    #[new]
    fn new(dt: f64, settings: BTreeMap<String, f64>) -> PyResult<Self> {
        let (limits, max_tail_ticks, stop_deceleration) = configure(settings)?;
        let max_tail_ticks =
            max_tail_ticks.unwrap_or_else(|| egp_gate::Gate::default_tail_ticks(dt));
        egp_gate::Gate::new(limits, dt, max_tail_ticks, stop_deceleration)
            .map(Self)
            .map_err(InvalidArgumentError::raise)
    }

    /// Store a plan of (T, 2) inputs whose first one is meant for period `tick`. Raises `InvalidArgumentError` for a plan that
    /// is empty, has too many inputs or has one that is not finite, and `EgpError` if the gate has stopped the vehicle or holds a
    /// plan for a later period.
    fn accept(&mut self, tick: u64, plan_u: Vec<[f64; 2]>) -> PyResult<()> {
        self.0.accept(tick, &plan_u).map_err(|error| match error {
            GateError::Stale { .. } | GateError::Stopped => raise(error),
            _ => InvalidArgumentError::raise(error),
        })
    }

    /// Return the command of period `tick` at this measured speed and steering angle.
    fn command(&mut self, tick: u64, v_x: f64, delta: f64) -> Command {
        let command = self.0.command(tick, v_x, delta);
        let [force, steering_rate] = command.u;
        Command {
            u: (force, steering_rate),
            mode: command.mode.name(),
            limited: command.limited,
        }
    }

    /// Leave STOP and forget the old plan.
    fn reset(&mut self) {
        self.0.reset();
    }

    /// The mode of the last command.
    #[getter]
    fn mode(&self) -> &'static str {
        self.0.mode().name()
    }
}
