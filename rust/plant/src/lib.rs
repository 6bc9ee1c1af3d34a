//! egp-plant: simulation of a 29-state multi-body vehicle on given road surfaces.
//!
//! The equations are those of the multi-body vehicle of the CommonRoad benchmarks (Althoff and Würsching,
//! "CommonRoad: Vehicle Models", 2020, section on the multi-body model, after R. W. Allen et al.,
//! "Steady State and Transient Analysis of Ground Vehicle Handling"): a sprung mass with yaw, roll, pitch and heave,
//! two unsprung axles with roll, heave and lateral motion, four spinning wheels, and two compliant joints between
//! them, on Pacejka tyres. [`derivative`] agrees with `commonroad-vehicle-models` 3.0.2 to rounding.
//!
//! # Axes
//! The original equations have y to the right and z down. Here the same numbers are read with y to the *left*, as in
//! the whole repository. The wheels of an axle are ordered by their y position, `-T/2` first: the "left" wheel of the
//! original is on the vehicle's right-hand side here and is the outer wheel for positive yaw rates.
//!
//! ```
//! use egp_plant::{Plant, Uniform, VehicleId, VehicleState};
//!
//! let mut plant = Plant::new(VehicleId::FordEscort.parameters());
//! plant.reset(&VehicleState { v_x: 15.0, ..VehicleState::default() })?;
//! let brake = [-3.0 * plant.parameters().mass, 0.0];
//! plant.step(brake, 0.05, &Uniform::new(0.8)?)?;
//! assert!(plant.vehicle_state().v_x < 15.0);
//! # Ok::<(), egp_plant::PlantError>(())
//! ```

mod axle;
mod disturbances;
mod dynamics;
mod effects;
mod error;
mod friction;
mod integrator;
mod limits;
mod parameters;
mod plant;
mod state;
mod tyre;

pub use egp_parameters::{ForceCurve, GRAVITY, Surface, SurfaceError};

pub use disturbances::Disturbances;
pub use dynamics::{KINEMATIC_SPEED, derivative};
pub use error::PlantError;
pub use friction::{Friction, Uniform};
pub use integrator::{MAX_SUBSTEP, longest_substep};
pub use limits::ActuatorLimits;
pub use parameters::{Axle, Joint, Parameters, SprungMass, VehicleId, Wheel};
pub use plant::Plant;
pub use state::{NX, STATE_NAMES, StateVector, VehicleState, initial_state};
pub use tyre::{Contact, TyreForce, TyreParameters};
