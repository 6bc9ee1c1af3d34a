//! Primal-dual active set: semismooth Newton steps on the augmented Lagrangian of the rows (Hintermüller, Ito &
//! Kunisch, SIAM J. Optim. 13, 2002), each one Riccati recursion.
//!
//! Each step fixes the working set and solves the LQ problem that remains. The rows active at its solution are the next
//! working set. Once the working set no longer changes, further steps refine the multipliers and need only a new
//! right-hand side. The method is fast from a good guess and exact where it converges, but it may cycle; the
//! interior-point method solves those problems.

use super::recursion::{Aug, Factor, Symmetric, backward, factorise, forward};
use super::stage::{INPUT, PAIRS, STATE, Stage, row_curvature, row_gradient, row_values};
use super::two_sided::{Estimate, Pairs, TwoSided, WorkingSet};
use crate::{Input, NU};

/// Penalty parameter `ρ` of the augmented Lagrangian as a multiple of the largest weight of the cost.
const RELATIVE_PENALTY: f64 = 1e6;

/// A bound is in the initial working set if the guessed input or state is nearer to it than this.
const ACTIVATION_DISTANCE: f64 = 1e-3;

/// Largest number of steps that refine the multipliers.
const MAX_REFINEMENTS: u32 = 15;

/// Largest number of steps that may fail to lower the number of changes of the working set.
const MAX_SETBACKS: u32 = 1;

/// Largest number of changes of the working set in one step, plus one for every other stage. Measured: of the starts
/// that converge, nine in ten change at most five rows; of the starts that change more rows than this, few converge.
const MAX_CHANGES: usize = 6;

/// Iterate and factorisation of one stage.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StageWork {
    pub v: [f64; NU],
    /// `s⁺`.
    pub s: Aug,
    /// Multipliers, positive at upper bounds.
    pub lambda: Pairs,
    estimate: Estimate,
    /// Derivatives of the estimate for which `factor` was computed; NaN without a factor.
    factored: Pairs,
    factor: Factor,
    /// Curvature of the cost-to-go of the next stage.
    cost_to_go: Symmetric,
    /// `L⁻¹ q_v` of the current right-hand side.
    feedforward: [f64; NU],
}

/// The active-set method and its memory.
#[derive(Clone, Debug)]
pub(super) struct ActiveSet {
    pub work: Vec<StageWork>,
    /// Iterations spent on the current problem, over all starts.
    pub iterations: u32,
    rho: f64,
}

/// Effect of a step on the rows.
struct Change {
    /// Number of rows that changed between active and inactive, or between satisfied and violated.
    rows: usize,
    /// Largest difference between a multiplier and its estimate, divided by `ρ`: the error in the value of an active
    /// row.
    gap: f64,
}

impl ActiveSet {
    pub fn new(horizon: usize) -> Self {
        Self {
            work: vec![StageWork::default(); horizon],
            iterations: 0,
            rho: 1.0,
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
    ///
    /// The method gives up when too many steps fail to lower the number of changes of the working set, or when one step
    /// changes too many rows: both are signs of cycling.
    #[inline(always)]
    pub fn solve(&mut self, stages: &[Stage], tolerance: f64) -> bool {
        let (mut fewest, mut setbacks, mut refinements) = (usize::MAX, 0, 0);
        let max_changes = MAX_CHANGES + stages.len() / 2;
        while setbacks <= MAX_SETBACKS && refinements <= MAX_REFINEMENTS {
            self.iterations += 1;
            if !self.backward(stages) {
                return false;
            }
            let change = self.forward(stages);
            if !change.gap.is_finite() || change.rows > max_changes {
                return false;
            }
            if change.rows > 0 {
                if change.rows < fewest {
                    fewest = change.rows;
                } else {
                    setbacks += 1;
                }
                continue;
            }
            if change.gap <= tolerance {
                for work in &mut self.work {
                    work.lambda = work.estimate.lambda;
                }
                return true;
            }
            refinements += 1;
            for (stage, work) in stages.iter().zip(&mut self.work) {
                work.lambda = work.estimate.lambda;
                let y = row_values(&work.v, &work.s, &stage.rows.normal);
                work.estimate = stage.rows.estimate(&y, &work.lambda, self.rho);
            }
        }
        false
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

    /// Forward sweep: takes the full step and updates the estimates.
    #[inline(always)]
    fn forward(&mut self, stages: &[Stage]) -> Change {
        let mut ds = Aug::default();
        let mut changed = [0_usize; PAIRS];
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
            let y = row_values(&work.v, &work.s, &stage.rows.normal);
            work.estimate = stage.rows.estimate(&y, &work.lambda, self.rho);
            for k in 0..PAIRS {
                changed[k] += usize::from(work.estimate.derivative[k] != work.factored[k]);
                let difference = (work.estimate.lambda[k] - work.lambda[k]).abs();
                gap[k] = if difference > gap[k] {
                    difference
                } else {
                    gap[k]
                };
            }
        }
        let gap = gap.iter().fold(0.0, |a: f64, b| a.max(*b)) / self.rho;
        Change {
            rows: changed.iter().sum(),
            gap: if dv_sum.is_finite() { gap } else { f64::NAN },
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
        self.estimate = rows.estimate_on(&set, &y, &self.lambda, rho);
        self.s
    }
}
