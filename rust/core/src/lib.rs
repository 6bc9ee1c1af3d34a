//! The mathematics of the controller: Gaussian processes, their ensemble and the control step.
//!
//! No I/O, clock, threads or logging. SI units and radians, yaw counter-clockwise from +x, `f64` throughout.
//! `NOTATION.md` maps the paper's symbols to the names used here.

mod ensemble;
mod executor;
pub mod friction;
pub mod gp;
mod kernel;
pub mod library;
pub mod linearisation;
pub mod ocp;
pub mod preview;
pub mod qp;
pub mod residual;
pub mod scaler;
pub mod settings;
pub mod solver;
pub mod step;
pub mod trajectory;
pub mod vehicle;
pub mod weights;

mod cholesky;
mod simd;

use nalgebra::{SMatrix, SVector};

pub use egp_parameters::{MOST_FORCE, ParameterError, VehicleParameters};
pub use ensemble::{Ensemble, MixtureScratch};
pub use executor::{Executor, Sequential};
pub use friction::FrictionEstimate;
pub use gp::VarianceScratch;
pub use kernel::Kernel;
pub use library::{Library, LibraryError, Member};
pub use qp::{OcpQp, OcpSolution};
pub use settings::{Settings, SettingsError};
#[doc(hidden)]
pub use simd::count_with_baseline_qp;
pub use simd::vector_instructions;
pub use solver::{QpSolver, Status};
pub use step::{StepError, StepReply, StepRequest, Workspace, step};

/// Number of states `[p_x, p_y, v_x, psi, v_y, omega, delta]`.
pub const NX: usize = 7;
/// Number of inputs `[F_x, delta_dot]`.
pub const NU: usize = 2;
/// Number of GP inputs `[v_x, v_y, omega, delta, F_x, delta_dot]`.
pub const NZ: usize = 6;
/// Number of GP outputs: the change of `[v_x, v_y, omega]` over one period `dt`.
pub const NY: usize = 3;

/// State `x = [p_x, p_y, v_x, psi, v_y, omega, delta]` in m, m, m/s, rad, m/s, rad/s, rad.
pub type State = SVector<f64, NX>;
/// Input `u = [F_x, delta_dot]` in N, rad/s.
pub type Input = SVector<f64, NU>;
/// GP input `z = [v_x, v_y, omega, delta, F_x, delta_dot]` in m/s, m/s, rad/s, rad, N, rad/s.
pub type GpInput = SVector<f64, NZ>;
/// GP output: the change of `[v_x, v_y, omega]` over `dt`, in m/s, m/s, rad/s.
pub type GpOutput = SVector<f64, NY>;
/// Jacobian of a GP output with respect to a GP input, both in physical units.
pub type GpJacobian = SMatrix<f64, NY, NZ>;
