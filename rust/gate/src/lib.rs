//! What may reach the actuators.
//!
//! Between any planner and the vehicle stands a [`Gate`]. It replays the newest plan by time, bridges
//! missing plans with the rest of the last one, brakes to a stop when that runs out, and holds every
//! output inside hard value and slew [`Limits`], whatever comes in. Fixed size, no allocation, no
//! clock, no network: it also runs on a small controller beside the actuators.
//!
//! ```
//! use egp_gate::{Gate, Limits, Mode};
//! use egp_parameters::VehicleParameters;
//! # fn main() -> Result<(), egp_gate::GateError> {
//! let limits = Limits::of(&VehicleParameters::FORD_ESCORT);
//! let mut gate = Gate::new(limits, 0.05, 1, 3.0)?;
//! gate.accept(0, &[[500.0, 0.1], [500.0, 0.0], [500.0, 0.0]])?;
//! assert_eq!(gate.command(0, 15.0, 0.0).mode, Mode::Normal);
//! assert_eq!(gate.command(1, 15.0, 0.0).mode, Mode::Tail); // no new plan came
//! assert_eq!(gate.command(2, 15.0, 0.0).mode, Mode::Stop); // one tail tick was allowed
//! # Ok(()) }
//! ```

mod gate;
mod limits;

pub use gate::{Command, Gate, GateError, MAX_HORIZON, Mode};
pub use limits::{Limits, LimitsError, WiderError};
