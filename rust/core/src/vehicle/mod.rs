//! The vehicle of eq. (11): where each quantity stands, known kinematics, the vehicles that a member may contain, and the
//! frame the step works in.

mod axles;
mod batch;
mod capacity;
mod euler;
#[cfg(test)]
mod example;
mod frame;
mod kinematic;
mod kinematics;
mod model;
mod resistance;
mod single_track;
mod tyre_limits;

use crate::NY;

pub(crate) use batch::Batch;
pub(crate) use frame::{Frame, wrap};
pub use kinematic::{KINEMATIC_PARAMETERS, Kinematic};
pub(crate) use kinematics::{gp_input, jacobians, successor};
pub use model::{ModelParameters, VehicleModel};
pub use resistance::Resistance;
pub use single_track::{SINGLE_TRACK_PARAMETERS, SingleTrack};
pub use tyre_limits::TyreLimits;
pub(crate) use tyre_limits::{ROLLING, SLIPPERY};

/// Index of `p_x` in the state, m.
pub(crate) const P_X: usize = 0;
/// Index of `p_y` in the state, m.
pub(crate) const P_Y: usize = 1;
/// Index of `v_x` in the state, m/s.
pub(crate) const V_X: usize = 2;
/// Index of `psi` in the state, rad.
pub(crate) const PSI: usize = 3;
/// Index of `v_y` in the state, m/s.
pub(crate) const V_Y: usize = 4;
/// Index of `omega` in the state, rad/s.
pub(crate) const OMEGA: usize = 5;
/// Index of `delta` in the state, rad.
pub(crate) const DELTA: usize = 6;

/// Indices of the states that the output of a GP changes, in its order.
pub(crate) const VELOCITIES: [usize; NY] = [V_X, V_Y, OMEGA];

/// Index of `delta` in the input of a GP, rad; the velocities stand before it.
pub(crate) const STEERING: usize = NY;

/// Index of `F_x` in the input (N), and of `a = F_x/m` (m/s²) in the scaled input.
pub(crate) const FORCE: usize = 0;
/// Index of `delta_dot` in the input, rad/s.
pub(crate) const DELTA_DOT: usize = 1;
