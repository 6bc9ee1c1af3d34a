//! The inequality rows of a stage in the form of the active-set method: two-sided, with one signed multiplier a row.
//!
//! For a row `lower <= y <= upper` with the multiplier `λ` and the penalty parameter `ρ`, the augmented Lagrangian
//! has the first-order multiplier estimate
//!
//! ```text
//! e = max(λ + ρ (y − upper), 0) + min(λ + ρ (y − lower), 0)
//! f = e                                        for |e| <= ρ₁   (hard rows: ρ₁ = ∞)
//!     sign(e) (ρ₁ + ρ₂/(ρ + ρ₂) (|e| − ρ₁))    otherwise
//! ```
//!
//! The second case is the proximal form of the penalty `ρ₁ s + ½ ρ₂ s²` of a soft row (Rockafellar, *Math. Oper. Res.*
//! 1, 1976). At a fixed point `f = λ` the estimate is the exact multiplier for every `ρ`.

use super::stage::PAIRS;
use crate::qp::Penalty;

pub(super) type Pairs = [f64; PAIRS];

/// Rows of a stage; absent rows have infinite bounds.
#[derive(Clone, Copy, Debug)]
pub(super) struct TwoSided {
    pub lower: Pairs,
    pub upper: Pairs,
    /// `ρ₁`, infinite for hard rows.
    pub linear: Pairs,
    /// `ρ₂`.
    pub quadratic: Pairs,
    /// Normal of the track row in the plane of positions.
    pub normal: [f64; 2],
}

impl Default for TwoSided {
    fn default() -> Self {
        Self {
            lower: [f64::NEG_INFINITY; PAIRS],
            upper: [f64::INFINITY; PAIRS],
            linear: [f64::INFINITY; PAIRS],
            quadratic: [0.0; PAIRS],
            normal: [0.0; 2],
        }
    }
}

impl TwoSided {
    /// Adds the hard bounds `lower..=upper` on row `k`.
    pub fn hard(&mut self, k: usize, lower: f64, upper: f64) {
        (self.lower[k], self.upper[k]) = (lower, upper);
    }

    /// Adds the soft bounds `lower..=upper` on row `k`.
    pub fn soft(&mut self, k: usize, lower: f64, upper: f64, penalty: Penalty) {
        self.hard(k, lower, upper);
        (self.linear[k], self.quadratic[k]) = (penalty.linear, penalty.quadratic);
    }
}

/// Multiplier estimates `f` and their derivatives in the row values.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Estimate {
    pub lambda: Pairs,
    pub derivative: Pairs,
}

impl TwoSided {
    /// The estimate `f` of the multiplier of row `k` at the value `y` and its derivative, in the case that `side` and
    /// `violated` give; the multiplier is `lambda`.
    #[inline(always)]
    pub fn multiplier_estimate(
        &self,
        k: usize,
        (side, violated): (f64, bool),
        y: f64,
        lambda: f64,
        rho: f64,
    ) -> (f64, f64) {
        if side == 0.0 {
            return (0.0, 0.0);
        }
        let bound = if side > 0.0 {
            self.upper[k]
        } else {
            self.lower[k]
        };
        let e = rho.mul_add(y - bound, lambda);
        if violated {
            let linear = side * self.linear[k];
            let share = self.quadratic[k] / (rho + self.quadratic[k]);
            (share.mul_add(e - linear, linear), share * rho)
        } else {
            (e, rho)
        }
    }

    /// The estimate with the cases of `f` given by the working set instead of by `y`.
    #[inline(always)]
    pub fn estimate_on(&self, set: &WorkingSet, y: &Pairs, lambda: &Pairs, rho: f64) -> Estimate {
        let mut out = Estimate::default();
        for k in 0..PAIRS {
            let case = (set.side[k], set.violated[k]);
            (out.lambda[k], out.derivative[k]) =
                self.multiplier_estimate(k, case, y[k], lambda[k], rho);
        }
        out
    }
}

/// A guess of the active rows of a stage.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WorkingSet {
    /// 1 for an active upper bound, -1 for an active lower bound, 0 for an inactive row.
    pub side: Pairs,
    /// Whether a soft row is violated, so that its multiplier exceeds `ρ₁`.
    pub violated: [bool; PAIRS],
}
