//! Errors of the plant.

use egp_parameters::{MEASURED_SPEED, SurfaceError};
use thiserror::Error;

use crate::VehicleId;

/// An invalid input or a failed step. The state is then unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PlantError {
    /// An unknown vehicle number.
    #[error(
        "expected the number of one of the CommonRoad vehicles {}, got {}",
        VehicleId::ALL.map(|id| id.number().to_string()).join(", "),
        .0
    )]
    UnknownVehicle(u32),
    /// A number that is not finite.
    #[error("expected a finite {name}, got {value}")]
    NotFinite {
        /// Name of the number.
        name: &'static str,
        /// The given value.
        value: f64,
    },
    /// A period that is not positive, or longer than 100 s.
    #[error("expected a period dt > 0 of at most 100 s, got {0} s: check its unit")]
    Period(f64),
    /// A surface for which the tyre has no force law.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// A negative speed, for which the tyre equations do not hold.
    #[error("expected a forward speed v_x >= 0, got {0} m/s; the vehicle only drives forward")]
    Backward(f64),
    /// A state outside the range of measured states, or a disturbance out of its range.
    #[error("expected {name} from {low} to {high} {unit}, got {value}: check its unit")]
    OutOfRange {
        /// Name of the number.
        name: &'static str,
        /// Its unit.
        unit: &'static str,
        /// Smallest value.
        low: f64,
        /// Largest value.
        high: f64,
        /// The given value.
        value: f64,
    },
    /// A wheel contact moves backward: the vehicle has spun.
    #[error(
        "wheel {wheel} (front -y, front +y, rear -y, rear +y) moves backward at {speed} m/s: the vehicle has spun, \
         for which the tyre equations do not hold; reset the plant or reduce the input"
    )]
    Spun {
        /// Index of the wheel.
        wheel: usize,
        /// Speed of its contact along the wheel, m/s.
        speed: f64,
    },
    /// The integration diverged.
    #[error("state {name} is no longer finite, last at v_x = {v_x} m/s; reset the plant")]
    Diverged {
        /// The first state that is not finite.
        name: &'static str,
        /// Speed at the last finite state, m/s.
        v_x: f64,
    },
}

/// Errors unless a forward speed is from 0 to [`MEASURED_SPEED`]'s largest, m/s.
pub(crate) fn check_forward_speed(v_x: f64) -> Result<(), PlantError> {
    if v_x < 0.0 {
        return Err(PlantError::Backward(v_x));
    }
    check_range("v_x", "m/s", v_x, (0.0, MEASURED_SPEED.1))
}

/// Errors unless `value` is from `low` to `high`.
pub(crate) fn check_range(
    name: &'static str,
    unit: &'static str,
    value: f64,
    (low, high): (f64, f64),
) -> Result<(), PlantError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(PlantError::OutOfRange {
        name,
        unit,
        low,
        high,
        value,
    })
}

/// `value` if it is finite.
pub(crate) fn finite(name: &'static str, value: f64) -> Result<f64, PlantError> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(PlantError::NotFinite { name, value })
    }
}
