//! The last check between a planner and the actuators.
//!
//! A [`Gate`] gives the newest plan's input for each control period, uses the rest of the last plan (its tail) while new
//! plans are missing, brakes to a stop when the tail ends, and keeps every output inside hard limits of value and slew
//! ([`Limits`]) for any input. It has a fixed size, no allocation, no clock and no network, so it also runs on a small
//! controller beside the actuators.
//!
//! ```
//! use egp_gate::{Gate, Limits, Mode};
//! use egp_parameters::VehicleParameters;
//! # fn main() -> Result<(), egp_gate::GateError> {
//! let limits = Limits::of(&VehicleParameters::FORD_ESCORT);
//! let mut gate = Gate::new(limits, 0.05, 1, 3.0)?;
//! gate.accept(0, &[[500.0, 0.1], [500.0, 0.0], [500.0, 0.0]])?;
//! assert_eq!(gate.command(0, 15.0, 0.0).mode, Mode::Normal);
//! assert_eq!(gate.command(1, 15.0, 0.0).mode, Mode::Tail); // no new plan was accepted
//! assert_eq!(gate.command(2, 15.0, 0.0).mode, Mode::Stop); // the tail may last one tick
//! # Ok(()) }
//! ```

mod gate;
mod limits;

pub use gate::{Command, Gate, GateError, MAX_HORIZON, Mode};
pub use limits::{Limits, LimitsError, WiderError};
