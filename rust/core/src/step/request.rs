//! Input and output of a step. All matrices are flat and row-major.

use crate::friction::FrictionEstimate;
use crate::solver::Status;

/// Input of a step, borrowed. `T` is the horizon of the settings, `N` the number of members, `k <= K` the number of
/// transitions sent.
#[derive(Debug, Clone, Copy, Default)]
pub struct StepRequest<'a> {
    /// Measured state `[p_x, p_y, v_x, psi, v_y, omega, delta]` in m, m, m/s, rad, m/s, rad/s, rad; `[7]`.
    pub x: &'a [f64],
    /// Applied input, `[2]`, in N and rad/s.
    pub u_prev: &'a [f64],
    /// Weights of the last reply, `[N]`; empty for uniform weights.
    pub weights: &'a [f64],
    /// States of the last plan in the units of `x`, `[T+1, 7]`; empty for a cold start.
    pub plan_x: &'a [f64],
    /// Inputs of the last plan, `[T, 2]`; empty exactly if `plan_x` is empty.
    pub plan_u: &'a [f64],
    /// Number of periods since the plan was made: 1 in steady operation, more after missed replies.
    pub plan_shift: u32,
    /// GP inputs `[v_x, v_y, omega, delta, F_x, delta_dot]` of the last transitions in m/s, m/s, rad/s, rad, N, rad/s;
    /// consecutive, newest first, `[k, 6]`.
    pub history_z: &'a [f64],
    /// Measured changes of `[v_x, v_y, omega]` over those transitions in m/s, m/s, rad/s; newest first, `[k, 3]`.
    pub history_y: &'a [f64],
    /// Predictions of the members for the *oldest* `k'` of those transitions, newest first, `[k', N, 3]`: the rows of
    /// the last reply without those that left the window. Predictions for the newest `k - k'` transitions are computed.
    pub history_f: &'a [f64],
    /// Reference `[p_x, p_y, v_x, psi]` in m, m, m/s, rad, now and after each period, `[T+1, 4]`. Yaw may be wrapped.
    pub reference: &'a [f64],
    /// Distances `[left, right]` in m from each reference point to the track edges, `[T+1, 2]`; empty if unknown.
    pub widths: &'a [f64],
    /// What is known about the road: rows of friction coefficient and standard deviation, first of the road on which the
    /// history was measured, then at the stages `0..=T`, `[T+2, 2]`; empty if nothing is known.
    pub road_friction: &'a [f64],
    /// Whether to compute standard deviations along the plan, which takes as long as one or two more steps.
    pub want_sigma: bool,
}

/// Output of a step, reused from step to step.
#[derive(Debug, Clone, PartialEq)]
pub struct StepReply {
    /// Outcome of the QP. Only [`Status::Solved`] comes with a plan.
    pub status: Status,
    /// Planned states in the units of [`StepRequest::x`], `[T+1, 7]`; row 0 is the measured state, not corrected for
    /// `measurement_delay`. Empty without a plan.
    pub plan_x: Vec<f64>,
    /// Planned inputs, `[T, 2]`, in N and rad/s. Empty without a plan.
    pub plan_u: Vec<f64>,
    /// Weights, `[N]`, on the simplex.
    pub weights: Vec<f64>,
    /// Friction coefficient that the window indicates.
    pub friction: FrictionEstimate,
    /// Standard deviation of `[v_x, v_y, omega]` in m/s, m/s, rad/s at each stage given the previous stage, `[T+1, 3]`; it
    /// includes noise and disagreement of the members. Row 1 is given the state at which the plan starts, which is the
    /// measured one corrected for `measurement_delay`. Empty unless requested.
    pub sigma: Vec<f64>,
    /// Predictions for all transitions of the request, newest first, `[k, N, 3]`, for the next request. With a measurement
    /// delay the oldest transitions, whose inputs are not in the request, may have predictions for other inputs; no estimate
    /// uses these.
    pub history_f: Vec<f64>,
    /// Sum of the weights of the members that are not in the control model.
    pub dropped_mass: f64,
    /// Iterations of the QP solver that ran last; those of a solver before it are not included.
    pub iterations: u32,
    /// KKT residual of the solution; infinite without a solution.
    pub kkt_residual: f64,
}

impl Default for StepReply {
    fn default() -> Self {
        Self {
            status: Status::NumericalError,
            plan_x: Vec::new(),
            plan_u: Vec::new(),
            weights: Vec::new(),
            friction: FrictionEstimate::default(),
            sigma: Vec::new(),
            history_f: Vec::new(),
            dropped_mass: 0.0,
            iterations: 0,
            kkt_residual: f64::INFINITY,
        }
    }
}

impl StepReply {
    /// Clears all fields but keeps the memory.
    pub(super) fn clear(&mut self) {
        for field in [
            &mut self.plan_x,
            &mut self.plan_u,
            &mut self.weights,
            &mut self.sigma,
            &mut self.history_f,
        ] {
            field.clear();
        }
        self.status = Status::NumericalError;
        self.friction = FrictionEstimate::default();
        self.dropped_mass = 0.0;
        self.iterations = 0;
        self.kkt_residual = f64::INFINITY;
    }
}
