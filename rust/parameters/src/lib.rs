//! egp-parameters: the numbers that describe one vehicle, the surfaces it drives on, and the gravity that acts on it.
//!
//! A library stores the [`VehicleParameters`] of the vehicle that its data come from. The control step, the speed
//! profile, the gate and the simulator take their numbers from there, so that each number is written down once.

mod commonroad;
mod domain;
mod friction;
pub mod range;
mod surface;
mod vehicle;

pub use domain::{
    MAGNITUDE, MEASURED_SPEED, MOST_FORCE, MOST_LATERAL_SPEED, MOST_STEERING_ANGLE, MOST_WIDTH,
    MOST_YAW_RATE, REFERENCE_SPEED, ROAD_FRICTION, SIMPLEX_TOLERANCE, STATE_IN_MESSAGES,
};
pub use friction::{
    FRICTION_HYPOTHESES, FRICTION_INFORMED, FRICTION_RANGE, LEAST_LOG_LIKELIHOOD,
    friction_hypotheses, interpolate_hypotheses,
};
pub use range::OutOfRange;
pub use surface::{ForceCurve, Surface, SurfaceError};
pub use vehicle::{FULL_SIZE, MIN_SLIP_SPEED, ParameterError, VehicleParameters, slip_speed};

/// Gravity of all vehicle models, in m/s²: that of the CommonRoad vehicles.
pub const GRAVITY: f64 = 9.81;

/// Standard gravity in m/s² (ISO 80000-3), which speed profiles multiply friction by, and the unit "g" of logs.
///
/// It stays apart from [`GRAVITY`] because the published results were measured with both: near the limit of the tyres
/// a speed that differs by 0.02 % gives other figures.
pub const STANDARD_GRAVITY: f64 = 9.806_65;
