//! Active-set method: equality-constrained subproblems on the augmented Lagrangian of the rows, by Riccati recursions.
//!
//! A subproblem fixes the working set: the rows at a bound and the soft rows that are violated. One recursion solves it.
//! Rows whose multiplier has the wrong sign leave the working set, all at once; rows that violate their bound enter it
//! one by one ([`super::exchange`]). Once no multiplier has the wrong sign and no free row violates its bound, further steps
//! refine the multipliers and need only a new right-hand side.
//!
//! The work is bounded: beyond a number of contradicting rows, changes or refinements the method gives up, and the
//! interior-point method solves the problem.

use super::low_rank::LowRank;
use super::one_sided::larger;
use super::recursion::{Aug, Factor, Symmetric, backward, factorise, forward};
use super::stage::{INPUT, PAIRS, STATE, Stage, row_curvature, row_gradient, row_values};
use super::two_sided::{Estimate, Pairs, TwoSided, WorkingSet};
use crate::{Input, NU};

/// Penalty parameter `ρ` of the augmented Lagrangian as a multiple of the largest weight of the cost.
const RELATIVE_PENALTY: f64 = 1e6;

/// A bound is in the initial working set if the guessed input or state is nearer to it than this, in the bound's unit (m/s²,
/// rad/s, m/s, rad or m). In all of these units it is far below the intervals between the bounds, and far above the
/// tolerance of the solver.
const ACTIVATION_DISTANCE: f64 = 1e-3;

/// Largest number of steps that refine the multipliers.
const MAX_REFINEMENTS: u32 = 15;

/// Up to this horizon the number of contradicting rows is not limited. Measured: at a horizon of 10 this is faster in the
/// median and at 99 %, at 20 and 40 it is slower at 99 %.
const SHORT_HORIZON: usize = 12;

/// Largest number of contradicting rows at a longer horizon. Measured: beyond it the changes cost more than the
/// interior-point method.
const MAX_CONTRADICTIONS: usize = 60;

/// Largest number of changes after one start of the method, and, at a short horizon, for each of its stages. This many changes
/// take at most as long as the interior-point method.
const MAX_EXCHANGES: usize = 32;
const MAX_EXCHANGES_SHORT: usize = 6;

/// Largest number of times that the working set is factorised anew after an exchange.
const MAX_ROUNDS: u32 = 6;

/// A multiplier may have the wrong sign by this share of `ρ`, which is the rounding of a row's value.
const SIGN_TOLERANCE: f64 = 2.5e-15;

/// Iterate and factorisation of one stage.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StageWork {
    pub v: [f64; NU],
    /// `s⁺`.
    pub s: Aug,
    /// Multipliers, positive at upper bounds.
    pub lambda: Pairs,
    pub(super) estimate: Estimate,
    /// The working set.
    pub(super) set: WorkingSet,
    /// Row values.
    pub(super) y: Pairs,
    /// Multipliers during an exchange.
    pub(super) multiplier: Pairs,
    /// Row values and multipliers of the subproblem that was factorised.
    pub(super) base: (Pairs, Pairs),
    /// Row values and multipliers of the subproblem of the present working set.
    pub(super) target: (Pairs, Pairs),
    /// Derivatives of the estimate for which `factor` was computed; NaN without a factor.
    pub(super) factored: Pairs,
    pub(super) factor: Factor,
    /// Curvature of the cost-to-go of the next stage.
    cost_to_go: Symmetric,
    /// `L⁻¹ q_v` of the current right-hand side.
    pub(super) feedforward: [f64; NU],
}

/// The active-set method and its memory.
#[derive(Clone, Debug)]
pub(super) struct ActiveSet {
    pub work: Vec<StageWork>,
    /// Iterations spent on the current problem, over all starts.
    pub iterations: u32,
    pub(super) rho: f64,
    pub(super) low_rank: LowRank,
    /// Exchanges left to the current start.
    pub(super) budget: usize,
}

impl ActiveSet {
    pub fn new(horizon: usize) -> Self {
        Self {
            work: vec![StageWork::default(); horizon],
            iterations: 0,
            rho: 1.0,
            low_rank: LowRank::new(horizon),
            budget: 0,
        }
    }

    /// Prepares the method for a problem: sets `ρ` and resets the iteration count.
    #[inline(always)]
    pub fn reset(&mut self, stages: &[Stage]) {
        self.iterations = 0;
        self.rho = RELATIVE_PENALTY
            * stages
                .iter()
                .flat_map(|s| s.cost.x.iter().chain(&s.cost.u).chain(&s.rate))
                .fold(f64::MIN_POSITIVE, |a, b| a.max(*b));
    }

    /// Iterates from the start that one of the functions below set; true if the method converged.
    #[inline(always)]
    pub fn solve(&mut self, stages: &[Stage], tolerance: f64) -> bool {
        let short = stages.len() <= SHORT_HORIZON;
        let (most, budget) = if short {
            (usize::MAX, MAX_EXCHANGES_SHORT * stages.len())
        } else {
            (MAX_CONTRADICTIONS, MAX_EXCHANGES)
        };
        self.budget = budget;
        let mut refinements = 0;
        for _ in 0..MAX_ROUNDS {
            loop {
                self.iterations += 1;
                if !self.backward(stages) {
                    return false;
                }
                let gap = self.forward(stages);
                if !gap.is_finite() {
                    return false;
                }
                let dropped = self.drop_contradictions(stages);
                let violations = self.violations(stages, tolerance);
                if dropped + violations > most {
                    return false;
                }
                if dropped == 0 {
                    if violations > 0 {
                        break;
                    }
                    for work in &mut self.work {
                        work.lambda = work.estimate.lambda;
                    }
                    if gap <= tolerance {
                        return true;
                    }
                }
                refinements += 1;
                if refinements > MAX_REFINEMENTS {
                    return false;
                }
                self.estimate(stages);
            }
            if !self.exchange(stages, tolerance) {
                return false;
            }
            self.estimate(stages);
        }
        false
    }

    /// Estimates of all stages at the present point, on the present working set.
    #[inline(always)]
    fn estimate(&mut self, stages: &[Stage]) {
        for (stage, work) in stages.iter().zip(&mut self.work) {
            let y = row_values(&work.v, &work.s, &stage.rows.normal);
            work.estimate = stage
                .rows
                .estimate_on(&work.set, &y, &work.lambda, self.rho);
        }
    }

    /// Takes rows out of the working set whose multiplier has the wrong sign, and corrects which soft rows are
    /// violated. Returns the number of rows that changed.
    #[inline(always)]
    fn drop_contradictions(&mut self, stages: &[Stage]) -> usize {
        let tolerance = SIGN_TOLERANCE * self.rho;
        let mut changed = 0;
        for (stage, work) in stages.iter().zip(&mut self.work) {
            for k in 0..PAIRS {
                let size = work.set.side[k] * work.estimate.lambda[k];
                let violated = work.set.violated[k];
                if size < -tolerance {
                    (work.set.side[k], work.set.violated[k]) = (0.0, false);
                    work.lambda[k] = 0.0;
                    changed += 1;
                } else if violated && size < stage.rows.linear[k] - tolerance
                    || !violated && size > stage.rows.linear[k] + tolerance
                {
                    work.set.violated[k] = !violated;
                    changed += 1;
                }
            }
        }
        changed
    }

    /// Starts from the LQ regulator without inequalities, whose controls are saturated at the bounds stage by stage.
    /// False if the factorisation fails.
    #[inline(always)]
    pub fn start_cold(&mut self, initial: &Aug, stages: &[Stage]) -> bool {
        let mut s = *initial;
        for (stage, work) in stages.iter().zip(&mut self.work) {
            s = stage.successor(&s, &[0.0; NU]);
            (work.v, work.s) = ([0.0; NU], s);
            work.estimate = Estimate::default();
            work.set = WorkingSet::default();
            work.factored = [f64::NAN; PAIRS];
        }
        if !self.backward(stages) {
            return false;
        }
        let mut s = *initial;
        let mut ds = Aug::default();
        for (stage, work) in stages.iter().zip(&mut self.work) {
            let (v, _) = forward(&stage.dynamics, &work.factor, &work.feedforward, &ds);
            let free = work.s;
            s = work.apply(stage, &s, v, 0.0, self.rho);
            ds = s.minus(&free);
        }
        true
    }

    /// Starts from guessed inputs, each moved onto a bound that is nearer than [`ACTIVATION_DISTANCE`].
    #[inline(always)]
    pub fn start_warm(&mut self, initial: &Aug, stages: &[Stage], guess: &[Input]) {
        let mut s = *initial;
        for ((stage, work), u) in stages.iter().zip(&mut self.work).zip(guess) {
            work.factored = [f64::NAN; PAIRS];
            let v = [u[0] - s.u[0], u[1] - s.u[1]];
            s = work.apply(stage, &s, v, ACTIVATION_DISTANCE, self.rho);
        }
    }

    /// Starts stage `t` from its control, state, multipliers and working set.
    #[inline(always)]
    pub fn start_stage(
        &mut self,
        t: usize,
        rows: &TwoSided,
        (v, s): ([f64; NU], Aug),
        lambda: Pairs,
        set: &WorkingSet,
    ) {
        let work = &mut self.work[t];
        (work.v, work.s, work.lambda) = (v, s, lambda);
        work.factored = [f64::NAN; PAIRS];
        let y = row_values(&v, &s, &rows.normal);
        work.set = *set;
        work.estimate = rows.estimate_on(set, &y, &lambda, self.rho);
    }

    /// Backward sweep of the Riccati recursion; factorises only from the last stage whose working set changed. False if
    /// a factorisation fails.
    #[inline(always)]
    fn backward(&mut self, stages: &[Stage]) -> bool {
        let mut gradient = Aug::default();
        let mut curvature = Symmetric::default();
        let mut stale = false;
        for (stage, work) in stages.iter().zip(&mut self.work).rev() {
            let (rows, estimate) = (&stage.rows, &work.estimate);
            // The comparison is true for a stage without a factor: NaN differs from every number.
            if stale || work.factored != estimate.derivative {
                if stale || work.factored[0].is_nan() {
                    work.cost_to_go = curvature;
                }
                stale = true;
                let mut next = work.cost_to_go;
                next.add(&stage.cost);
                next.add(&row_curvature(&estimate.derivative, &rows.normal));
                let rate = [
                    stage.rate[0] + estimate.derivative[0],
                    stage.rate[1] + estimate.derivative[1],
                ];
                let Some((factor, before)) = factorise(&stage.dynamics, &rate, &next) else {
                    return false;
                };
                (work.factor, curvature) = (factor, before);
                work.factored = estimate.derivative;
            }
            let mut next = stage.cost_gradient(&work.s);
            next.add(&row_gradient(&estimate.lambda, &rows.normal));
            next.add(&gradient);
            let g_v = [
                stage.rate[0].mul_add(work.v[0], estimate.lambda[0]),
                stage.rate[1].mul_add(work.v[1], estimate.lambda[1]),
            ];
            (gradient, work.feedforward) = backward(&stage.dynamics, &work.factor, &next, &g_v);
        }
        true
    }

    /// Forward sweep: takes the full step and updates row values and estimates. Returns the largest difference between
    /// a multiplier and its estimate, divided by `ρ`: the error in the value of an active row.
    #[inline(always)]
    fn forward(&mut self, stages: &[Stage]) -> f64 {
        let mut ds = Aug::default();
        let mut gap = [0.0_f64; PAIRS];
        let mut dv_sum = 0.0;
        for (stage, work) in stages.iter().zip(&mut self.work) {
            let (dv, next) = forward(&stage.dynamics, &work.factor, &work.feedforward, &ds);
            ds = next;
            work.s.add(&ds);
            for i in 0..NU {
                work.v[i] += dv[i];
                dv_sum += dv[i];
            }
            work.y = row_values(&work.v, &work.s, &stage.rows.normal);
            work.estimate = stage
                .rows
                .estimate_on(&work.set, &work.y, &work.lambda, self.rho);
            for k in 0..PAIRS {
                gap[k] = larger((work.estimate.lambda[k] - work.lambda[k]).abs(), gap[k]);
            }
        }
        if dv_sum.is_finite() {
            gap.iter().fold(0.0, |a: f64, b| a.max(*b)) / self.rho
        } else {
            f64::NAN
        }
    }
}

impl StageWork {
    /// Sets the stage to the control `v`, clipped to the hard bounds and moved onto those nearer than `near`, and to
    /// the working set of the bounds that its rows reach. Returns the next state.
    #[inline(always)]
    fn apply(&mut self, stage: &Stage, s: &Aug, v: [f64; NU], near: f64, rho: f64) -> Aug {
        let rows = &stage.rows;
        let mut set = WorkingSet::default();
        let snap = |k: usize, value: f64| {
            let (value, side) = if value >= rows.upper[k] - near {
                (rows.upper[k], 1.0)
            } else if value <= rows.lower[k] + near {
                (rows.lower[k], -1.0)
            } else {
                (value, 0.0)
            };
            (value, side)
        };
        for i in 0..NU {
            let (input, side) = snap(INPUT + i, s.u[i] + v[i]);
            let rate = input - s.u[i];
            (self.v[i], set.side[i]) = snap(i, rate);
            if self.v[i] == rate {
                set.side[INPUT + i] = side; // otherwise the rate bound changed the input
            }
        }
        self.s = stage.successor(s, &self.v);
        let y = row_values(&self.v, &self.s, &rows.normal);
        for k in STATE..PAIRS {
            let (above, below) = (y[k] - rows.upper[k], rows.lower[k] - y[k]);
            if above > -near || below > -near {
                set.side[k] = if above > below { 1.0 } else { -1.0 };
                set.violated[k] = above.max(below) > near;
            }
        }
        self.lambda = [0.0; PAIRS];
        self.set = set;
        self.estimate = rows.estimate_on(&set, &y, &self.lambda, rho);
        self.s
    }
}
