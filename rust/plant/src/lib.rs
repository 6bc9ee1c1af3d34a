//! egp-plant: the simulated truth, a 29-state multi-body vehicle on a surface of given friction.
//!
//! The equations are those of the multi-body vehicle of the CommonRoad benchmarks (Althoff and Würsching,
//! "CommonRoad: Vehicle Models", 2020, section on the multi-body model, after R. W. Allen et al.,
//! "Steady State and Transient Analysis of Ground Vehicle Handling"): a sprung mass with yaw, roll, pitch and heave,
//! two unsprung axles with roll, heave and lateral motion, four spinning wheels, and two compliant joints between
//! them, on Pacejka tyres. [`derivative`] agrees with `commonroad-vehicle-models` 3.0.2 to rounding.
//!
//! # Axes
//! The equations were written with y to the right and z down, and we read the same numbers with y to the *left*, as
//! everywhere in this repository. So a wheel pair is ordered by its y position, `-T/2` first: the wheel the original
//! calls "left" is on the vehicle's right-hand side here. It is the outer wheel when the yaw rate is positive.
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

#![forbid(unsafe_code)]

mod axle;
mod batch;
mod dynamics;
mod error;
mod friction;
mod integrator;
mod limits;
mod parameters;
mod plant;
mod state;
mod tyre;

pub use egp_parameters::GRAVITY;

pub use batch::{BatchItem, step_batch};
pub use dynamics::{KINEMATIC_SPEED, derivative, lateral_acceleration};
pub use error::PlantError;
pub use friction::{Friction, Map, Uniform};
pub use integrator::{MAX_SUBSTEP, longest_substep};
pub use limits::Limits;
pub use parameters::{Axle, Joint, Parameters, SprungMass, VehicleId, Wheel};
pub use plant::Plant;
pub use state::{NX, STATE_NAMES, StateVector, VehicleState, initial_state};
pub use tyre::{Contact, TyreForce, TyreParameters};
