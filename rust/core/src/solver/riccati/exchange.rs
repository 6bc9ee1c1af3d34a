//! Dual active-set method: one row of the working set changes at a time (Goldfarb & Idnani, *Math. Program.* 27, 1983).
//!
//! Over the multipliers, the dual of the problem is a concave piecewise quadratic function without constraints: a hard
//! row contributes its bound, a soft row also the conjugate of its penalty. The pieces meet where a multiplier is zero
//! or `ρ₁`. From a point whose multipliers have the right signs the method adds the free row that violates its bound
//! most, moves towards the solution on the new working set, and stops where a multiplier reaches the end of its piece:
//! the row then leaves the working set, or changes between satisfied and violated. The dual does not decrease. In a
//! degenerate problem steps of length zero may repeat; the budget of changes bounds them.

use super::active_set::ActiveSet;
use super::low_rank::Place;
use super::one_sided::larger;
use super::recursion::{Aug, backward, forward};
use super::stage::{PAIRS, Stage, row_gradient, row_values};
use crate::NU;

/// Changes after which the rest of the budget must cover the violated rows. The first changes often correct several rows
/// at once; after them the number of violated rows decreases by one or less with each change.
const PROBE: usize = 8;

/// Added to the interval between a row's bounds, in the row's unit (m/s², rad/s, m/s, rad or m), so that a violation of equal
/// bounds is a finite share of it.
const LEAST_INTERVAL: f64 = 1e-3;

impl ActiveSet {
    /// Number of free rows that violate their bound.
    #[inline(always)]
    pub(super) fn violations(&self, stages: &[Stage], tolerance: f64) -> usize {
        let mut count = [0; PAIRS];
        for (stage, work) in stages.iter().zip(&self.work) {
            for k in 0..PAIRS {
                let excess = larger(
                    work.y[k] - stage.rows.upper[k],
                    stage.rows.lower[k] - work.y[k],
                );
                count[k] += usize::from(work.set.side[k] == 0.0 && excess > tolerance);
            }
        }
        count.iter().sum()
    }

    /// The free row that violates its bound most, in shares of the interval between its bounds, and the number of free
    /// rows that violate theirs.
    #[inline(always)]
    fn largest_violation(&self, stages: &[Stage], tolerance: f64) -> Option<(Place, usize)> {
        let (mut worst, mut place, mut count) = (0.0, None, [0; PAIRS]);
        for (t, (stage, work)) in stages.iter().zip(&self.work).enumerate() {
            let mut shares = [0.0; PAIRS];
            for k in 0..PAIRS {
                let (upper, lower) = (stage.rows.upper[k], stage.rows.lower[k]);
                let excess = larger(work.y[k] - upper, lower - work.y[k]);
                let free = work.set.side[k] == 0.0 && excess > tolerance;
                count[k] += usize::from(free);
                shares[k] = if free {
                    excess / (upper - lower + LEAST_INTERVAL)
                } else {
                    0.0
                };
            }
            for k in 0..PAIRS {
                if shares[k] > worst {
                    (worst, place) = (shares[k], Some((t, k)));
                }
            }
        }
        place.map(|place| (place, count.iter().sum()))
    }

    /// Changes the working set until no free row violates its bound; false if the budget of changes is spent or will not
    /// suffice, if more rows change than the low-rank factorisation can hold, or if a pivot of it vanishes. The present
    /// point must solve the subproblem of the factorised working set.
    #[inline(always)]
    pub(super) fn exchange(&mut self, stages: &[Stage], tolerance: f64) -> bool {
        self.low_rank.clear();
        for work in &mut self.work {
            work.base = (work.y, work.estimate.lambda);
            work.multiplier = work.estimate.lambda;
        }
        let probed = self.budget.saturating_sub(PROBE);
        while let Some(((t, k), violations)) = self.largest_violation(stages, tolerance) {
            if self.budget <= probed && violations > self.budget {
                return false;
            }
            let work = &mut self.work[t];
            let side = if work.y[k] > stages[t].rows.upper[k] {
                1.0
            } else {
                -1.0
            };
            (work.set.side[k], work.set.violated[k]) = (side, false);
            let mut changed = Some((t, k));
            while let Some(place) = changed {
                if self.budget == 0 || !self.update(stages, place) {
                    return false;
                }
                self.budget -= 1;
                self.iterations += 1;
                changed = self.advance(stages);
            }
        }
        true
    }

    /// Brings the low-rank factorisation up to date with the working set at one row.
    #[inline(always)]
    fn update(&mut self, stages: &[Stage], (t, k): Place) -> bool {
        let column = if let Some(column) = self.low_rank.find((t, k)) {
            column
        } else {
            // The sweeps solve for a gradient, so the column z = A H⁻¹ aᵀ is minus their result.
            let mut unit = [0.0; PAIRS];
            unit[k] = 1.0;
            let mut gradient = Aug::default();
            let Some((index, values)) = self.low_rank.reserve((t, k)) else {
                return false;
            };
            let mut next = row_gradient(&unit, &stages[t].rows.normal);
            let mut g_v = [unit[0], unit[1]];
            for (stage, work) in stages[..=t].iter().zip(&mut self.work[..=t]).rev() {
                next.add(&gradient);
                (gradient, work.feedforward) = backward(&stage.dynamics, &work.factor, &next, &g_v);
                (next, g_v) = (Aug::default(), [0.0; NU]);
            }
            let mut ds = Aug::default();
            for (i, ((stage, work), value)) in stages.iter().zip(&self.work).zip(values).enumerate()
            {
                let y = if i <= t { work.feedforward } else { [0.0; NU] };
                let (dv, after) = forward(&stage.dynamics, &work.factor, &y, &ds);
                ds = after;
                *value = row_values(&dv, &ds, &stage.rows.normal).map(|v| -v);
            }
            index
        };
        let (work, rows) = (&self.work[t], &stages[t].rows);
        let case = (work.set.side[k], work.set.violated[k]);
        let (estimate, derivative) =
            rows.multiplier_estimate(k, case, work.base.0[k], work.lambda[k], self.rho);
        let (delta, excess) = (derivative - work.factored[k], estimate - work.base.1[k]);
        self.low_rank.set(column, delta, excess)
    }

    /// Moves towards the solution on the working set. Returns the row at which the move ended early, whose state has
    /// been changed.
    #[inline(always)]
    fn advance(&mut self, stages: &[Stage]) -> Option<Place> {
        for (t, work) in self.work.iter_mut().enumerate() {
            let mut shift = [0.0; PAIRS];
            self.low_rank.shift(t, &mut shift);
            for k in 0..PAIRS {
                work.target.0[k] = work.base.0[k] + shift[k];
                work.target.1[k] = work.factored[k].mul_add(shift[k], work.base.1[k]);
            }
        }
        for ((t, k), difference) in self.low_rank.differences() {
            self.work[t].target.1[k] += difference;
        }
        let (mut length, mut first, mut leaves) = (1.0, None, false);
        for (t, (stage, work)) in stages.iter().zip(&mut self.work).enumerate() {
            for k in 0..PAIRS {
                let side = work.set.side[k];
                if side == 0.0 {
                    work.target.1[k] = 0.0;
                    continue;
                }
                let (now, then) = (side * work.multiplier[k], side * work.target.1[k]);
                let linear = stage.rows.linear[k];
                let (end, out) = if work.set.violated[k] {
                    (linear, then < linear)
                } else if then < 0.0 {
                    (0.0, true)
                } else {
                    (linear, then > linear)
                };
                if out {
                    let share = ((end - now) / (then - now)).max(0.0);
                    if share < length {
                        (length, first, leaves) = (share, Some((t, k)), end == 0.0);
                    }
                }
            }
        }
        for work in &mut self.work {
            for k in 0..PAIRS {
                work.y[k] += length * (work.target.0[k] - work.y[k]);
                work.multiplier[k] += length * (work.target.1[k] - work.multiplier[k]);
            }
        }
        if let Some((t, k)) = first {
            let work = &mut self.work[t];
            if leaves {
                (work.set.side[k], work.set.violated[k]) = (0.0, false);
                work.multiplier[k] = 0.0;
            } else {
                work.set.violated[k] = !work.set.violated[k];
                work.multiplier[k] = work.set.side[k] * stages[t].rows.linear[k];
            }
        }
        first
    }
}
