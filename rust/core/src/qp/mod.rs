//! The QP of eq. (18): an optimal control problem, stage by stage.
//!
//! With scaled inputs `u = [a, delta_dot]` and states `x_0` given,
//!
//! ```text
//! min  Σ_{t=0}^{T-1}  ½ (x_{t+1} - r_{t+1})ᵀ Q_{t+1} (x_{t+1} - r_{t+1}) + ½ u_tᵀ R u_t
//!                   + ½ (u_t - u_{t-1})ᵀ R_d (u_t - u_{t-1}) + ½ (u_t - ū_t)ᵀ D_t (u_t - ū_t)
//!                   + Σ_j penalty_j(s_{t+1,j})
//! s.t. x_{t+1} = A_t x_t + B_t u_t + c_t
//!      u_min_t <= u_t <= u_max_t,   du_min_t <= u_t - u_{t-1} <= du_max_t     (hard; u_{-1} is the applied input)
//!      lower_j - s_j <= g_jᵀ x_{t+1} <= upper_j + s_j,   s_j >= 0             (soft)
//! ```
//!
//! with `penalty(s) = linear·s + ½ quadratic·s²`. Both sides of a row share a slack because at most one can be
//! violated. The data of a stage are in arrays of fixed size, for solvers that exploit the structure.

mod kkt;
mod solution;
mod sparse;

use nalgebra::SMatrix;

pub use kkt::KktResidual;
pub use solution::{Multipliers, OcpSolution};
pub use sparse::{Csc, SparseQp};

use crate::vehicle::{DELTA, OMEGA, P_X, P_Y, PSI, V_X, V_Y};
use crate::{Input, NU, NX, State};

/// Penalty of a soft row violated by `s`: `linear·s + ½ quadratic·s²`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Penalty {
    /// Positive, 1 per unit of the row.
    pub linear: f64,
    /// Positive, 1 per squared unit.
    pub quadratic: f64,
}

/// Largest number of soft rows of a stage: speed, steering angle, track edges, lateral speed, yaw rate.
pub const MAX_SOFT: usize = 5;

/// States that each soft row may involve; the rest of its normal is zero.
pub const SOFT_PATTERN: [&[usize]; MAX_SOFT] = [&[V_X], &[DELTA], &[P_X, P_Y], &[V_Y], &[OMEGA]];

/// The soft row that bounds the speed.
pub(crate) const SOFT_SPEED: usize = 0;
/// The soft row that bounds the position by the track's edges.
pub(crate) const SOFT_TRACK: usize = 2;

/// States (as columns) that each row of `A` may involve, by eq. (11) with positions along the yaw at any time of the
/// period.
pub const A_PATTERN: [&[usize]; NX] = [
    &[P_X, V_X, PSI, V_Y, OMEGA],
    &[P_Y, V_X, PSI, V_Y, OMEGA],
    &[V_X, V_Y, OMEGA, DELTA],
    &[PSI, OMEGA],
    &[V_X, V_Y, OMEGA, DELTA],
    &[V_X, V_Y, OMEGA, DELTA],
    &[DELTA],
];

/// Inputs (as columns) that each row of `B` may involve, by eq. (11).
pub const B_PATTERN: [&[usize]; NX] = [&[], &[], &[0, 1], &[], &[0, 1], &[0, 1], &[1]];

/// Upper-triangle entries that `Q` may have: a position block and a diagonal.
pub const Q_PATTERN: [(usize, usize); NX + 1] = [
    (P_X, P_X),
    (P_X, P_Y),
    (P_Y, P_Y),
    (V_X, V_X),
    (PSI, PSI),
    (V_Y, V_Y),
    (OMEGA, OMEGA),
    (DELTA, DELTA),
];

/// A soft two-sided bound `lower <= gᵀx <= upper`, both finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoftRow {
    /// Normal `g`. In a row whose pattern has one state, [`crate::solver::RiccatiSolver`] takes the entry for 1; with
    /// another one it finds no solution that passes the check, and the fallback solver solves the problem.
    pub normal: State,
    /// Lower bound.
    pub lower: f64,
    /// Upper bound.
    pub upper: f64,
}

impl SoftRow {
    /// A row that is never violated, which keeps the pattern when a bound is absent.
    pub fn inactive() -> Self {
        Self {
            normal: State::zeros(),
            lower: -1.0,
            upper: 1.0,
        }
    }
}

/// Transition `t` to `t+1` with the bounds on `u_t` and the cost and soft bounds of `x_{t+1}`.
#[derive(Debug, Clone, PartialEq)]
pub struct Stage {
    /// `A_t`, within [`A_PATTERN`].
    pub a: SMatrix<f64, NX, NX>,
    /// `B_t` for scaled inputs, within [`B_PATTERN`].
    pub b: SMatrix<f64, NX, NU>,
    /// `c_t`.
    pub c: State,
    /// `Q_{t+1}`, symmetric positive semi-definite, within [`Q_PATTERN`].
    pub q: SMatrix<f64, NX, NX>,
    /// `r_{t+1}`.
    pub reference: State,
    /// Diagonal of `D_t`, not negative.
    pub proximal: Input,
    /// `ū_t`, the input of the previous plan.
    pub planned: Input,
    /// Lower bound of `u_t`.
    pub u_min: Input,
    /// Upper bound of `u_t`.
    pub u_max: Input,
    /// Lower bound of `u_t - u_{t-1}`.
    pub du_min: Input,
    /// Upper bound of `u_t - u_{t-1}`.
    pub du_max: Input,
    /// Soft rows on `x_{t+1}`, row `j` within [`SOFT_PATTERN`]`[j]`; only the first [`OcpQp::n_soft`] are used.
    pub soft: [SoftRow; MAX_SOFT],
}

impl Stage {
    fn neutral() -> Self {
        Self {
            a: SMatrix::identity(),
            b: SMatrix::zeros(),
            c: State::zeros(),
            q: SMatrix::identity(),
            reference: State::zeros(),
            proximal: Input::zeros(),
            planned: Input::zeros(),
            u_min: Input::repeat(-1.0),
            u_max: Input::repeat(1.0),
            du_min: Input::repeat(-1.0),
            du_max: Input::repeat(1.0),
            soft: [SoftRow::inactive(); MAX_SOFT],
        }
    }
}

/// The whole problem; see the module's formula.
#[derive(Debug, Clone, PartialEq)]
pub struct OcpQp {
    /// Measured state `x_0`.
    pub x0: State,
    /// Applied input `u_{-1}`, scaled.
    pub u_prev: Input,
    /// Diagonal of `R`, positive.
    pub r: Input,
    /// Diagonal of `R_d`.
    pub r_d: Input,
    /// Penalty of each soft row, the same at all stages.
    pub penalty: [Penalty; MAX_SOFT],
    /// Soft rows in use; part of the pattern, fixed at construction.
    n_soft: usize,
    /// Stages `0..T`; their number is part of the pattern.
    stages: Vec<Stage>,
}

impl OcpQp {
    /// A placeholder problem that fixes the pattern of later data: `horizon` stages with `n_soft` soft rows.
    pub fn new(horizon: usize, n_soft: usize) -> Self {
        Self {
            x0: State::zeros(),
            u_prev: Input::zeros(),
            r: Input::repeat(1.0),
            r_d: Input::repeat(1.0),
            penalty: [Penalty {
                linear: 1.0,
                quadratic: 1.0,
            }; MAX_SOFT],
            n_soft: n_soft.min(MAX_SOFT),
            stages: vec![Stage::neutral(); horizon],
        }
    }

    /// Number of inputs `T`.
    pub fn horizon(&self) -> usize {
        self.stages.len()
    }

    /// Number of soft rows a stage.
    pub fn n_soft(&self) -> usize {
        self.n_soft
    }

    /// The stages.
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }

    /// The stages, mutable.
    pub fn stages_mut(&mut self) -> &mut [Stage] {
        &mut self.stages
    }

    /// `u_{t-1}` in a sequence of inputs, which is the applied input for `t = 0`.
    pub(crate) fn previous<'a>(&'a self, u: &'a [Input], t: usize) -> &'a Input {
        t.checked_sub(1).map_or(&self.u_prev, |before| &u[before])
    }

    /// Gradient of the cost in `x_{t+1}` at the state `x`, penalties of the soft rows without the track's edges included, with
    /// the multiplier `adjoint` of transition `t + 1`. At the end of the horizon the latter is not used.
    pub(crate) fn state_gradient(&self, t: usize, x: &State, adjoint: &State) -> State {
        let stage = &self.stages[t];
        let mut gradient = stage.q * (x - stage.reference);
        let rows = stage.soft[..self.n_soft].iter().zip(&self.penalty);
        for (_, (row, penalty)) in rows.enumerate().filter(|(i, _)| *i != SOFT_TRACK) {
            let value = row.normal.dot(x);
            let (excess, sign) = if value > row.upper {
                (value - row.upper, 1.0)
            } else {
                (row.lower - value, -1.0)
            };
            if excess > 0.0 {
                gradient += row.normal * (sign * (penalty.linear + penalty.quadratic * excess));
            }
        }
        match self.stages.get(t + 1) {
            Some(next) => gradient + next.a.tr_mul(adjoint),
            None => gradient,
        }
    }

    /// States that follow from `x_0` under the inputs `u`, written to `x` (`T+1` rows).
    pub fn roll_out(&self, u: &[Input], x: &mut [State]) {
        x[0] = self.x0;
        for (t, stage) in self.stages.iter().enumerate() {
            x[t + 1] = stage.a * x[t] + stage.b * u[t] + stage.c;
        }
    }

    /// Whether a sequence of inputs satisfies all hard bounds. They bound each input and its changes, so that the values an
    /// input can reach at a stage are an interval, and such a sequence exists exactly if none of these intervals is empty.
    pub fn has_feasible_inputs(&self) -> bool {
        (0..NU).all(|i| {
            let (mut low, mut high) = (self.u_prev[i], self.u_prev[i]);
            self.stages.iter().all(|stage| {
                low = (low + stage.du_min[i]).max(stage.u_min[i]);
                high = (high + stage.du_max[i]).min(stage.u_max[i]);
                low <= high
            })
        })
    }

    /// True if every number of the stages and the start is finite and no lower bound exceeds its upper bound.
    pub fn is_well_posed(&self) -> bool {
        let finite = |m: &[f64]| m.iter().all(|v| v.is_finite());
        let row = |row: &SoftRow| {
            finite(row.normal.as_slice())
                && finite(&[row.lower, row.upper])
                && row.lower <= row.upper
        };
        let stage = |s: &Stage| {
            let matrices = [s.a.as_slice(), s.b.as_slice(), s.q.as_slice()];
            let states = [s.c.as_slice(), s.reference.as_slice()];
            let inputs = [
                &s.proximal,
                &s.planned,
                &s.u_min,
                &s.u_max,
                &s.du_min,
                &s.du_max,
            ];
            matrices.into_iter().all(finite)
                && states.into_iter().all(finite)
                && inputs.into_iter().all(|u| finite(u.as_slice()))
                && (0..NU).all(|i| s.u_min[i] <= s.u_max[i] && s.du_min[i] <= s.du_max[i])
                && s.soft[..self.n_soft].iter().all(row)
        };
        finite(self.x0.as_slice())
            && finite(self.u_prev.as_slice())
            && self.stages.iter().all(stage)
    }

    /// True if no entry lies outside [`A_PATTERN`], [`B_PATTERN`], [`Q_PATTERN`] and [`SOFT_PATTERN`].
    pub fn keeps_pattern(&self) -> bool {
        self.stages.iter().all(|s| {
            (0..NX).all(|i| {
                (0..NX).all(|j| {
                    let (low, high) = (i.min(j), i.max(j));
                    (s.a[(i, j)] == 0.0 || A_PATTERN[i].contains(&j))
                        && s.q[(i, j)] == s.q[(j, i)]
                        && (s.q[(i, j)] == 0.0 || Q_PATTERN.contains(&(low, high)))
                }) && (0..NU).all(|j| s.b[(i, j)] == 0.0 || B_PATTERN[i].contains(&j))
            }) && (0..self.n_soft).all(|j| {
                (0..NX).all(|i| s.soft[j].normal[i] == 0.0 || SOFT_PATTERN[j].contains(&i))
            })
        })
    }
}
