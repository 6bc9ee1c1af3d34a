//! The solution of an [`OcpQp`](super::OcpQp).

use super::{KktResidual, MAX_SOFT};
use crate::solver::Status;
use crate::{Input, State};

/// Lagrange multipliers of one stage's inequalities, all >= 0 at a solution.
///
/// The multipliers of the dynamics follow from them by the adjoint recursion, and those of `s >= 0` by stationarity in
/// `s`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Multipliers {
    /// Multiplier of `u_min <= u`.
    pub u_lower: Input,
    /// Multiplier of `u <= u_max`.
    pub u_upper: Input,
    /// Multiplier of `du_min <= u_t - u_{t-1}`.
    pub du_lower: Input,
    /// Multiplier of `u_t - u_{t-1} <= du_max`.
    pub du_upper: Input,
    /// Multipliers of `lower - s <= gᵀx`.
    pub soft_lower: [f64; MAX_SOFT],
    /// Multipliers of `gᵀx <= upper + s`.
    pub soft_upper: [f64; MAX_SOFT],
}

/// Inputs, the states that follow from them, multipliers and KKT residual.
#[derive(Debug, Clone, PartialEq)]
pub struct OcpSolution {
    /// States `x_0..=x_T`, rolled out from the inputs: the dynamics hold to rounding.
    pub x: Vec<State>,
    /// Scaled inputs `u_0..u_{T-1}`.
    pub u: Vec<Input>,
    /// Multipliers of stages `0..T`.
    pub multipliers: Vec<Multipliers>,
    /// Outcome of the solve.
    pub status: Status,
    /// Iterations of the solver.
    pub iterations: u32,
    /// KKT residual computed by [`OcpQp::check`](super::OcpQp::check).
    pub kkt: KktResidual,
    /// Cost of the inputs, computed by [`OcpQp::check`](super::OcpQp::check); infinite before.
    pub cost: f64,
    /// Adjoint states, memory of the check.
    pub(super) adjoint: Vec<State>,
}

impl OcpSolution {
    /// Memory for a horizon of `horizon` inputs.
    pub fn new(horizon: usize) -> Self {
        Self {
            x: vec![State::zeros(); horizon + 1],
            u: vec![Input::zeros(); horizon],
            multipliers: vec![Multipliers::default(); horizon],
            status: Status::NumericalError,
            iterations: 0,
            kkt: KktResidual::default(),
            cost: f64::INFINITY,
            adjoint: vec![State::zeros(); horizon + 1],
        }
    }
}
