//! Simulated vehicles that drive through the service as real ones would: plant, path and onboard client.

mod course;
mod vehicle;

pub use course::{Course, CourseError, Track};
pub use vehicle::{CAR, Period, SimulatedVehicle, SimulationError};
