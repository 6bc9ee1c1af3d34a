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
use crate::settings::Penalty;

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
    /// The estimate at row values `y` and multipliers `lambda`, for the penalty parameter `rho`.
    #[inline(always)]
    pub fn estimate(&self, y: &Pairs, lambda: &Pairs, rho: f64) -> Estimate {
        let mut out = Estimate::default();
        for k in 0..PAIRS {
            let above = rho.mul_add(y[k] - self.upper[k], lambda[k]);
            let below = rho.mul_add(y[k] - self.lower[k], lambda[k]);
            let above = if above > 0.0 { above } else { 0.0 };
            let below = if below < 0.0 { below } else { 0.0 };
            let e = above + below;
            let size = e.abs();
            let excess = size - self.linear[k];
            let share = self.quadratic[k] / (rho + self.quadratic[k]);
            let violated = excess > 0.0;
            let estimate = if violated {
                share.mul_add(excess, self.linear[k])
            } else {
                size
            };
            let derivative = if violated { share * rho } else { rho };
            out.lambda[k] = estimate.copysign(e);
            out.derivative[k] = if size > 0.0 { derivative } else { 0.0 };
        }
        out
    }

    /// The estimate with the cases of `f` given by the working set instead of by `y`.
    #[inline(always)]
    pub fn estimate_on(&self, set: &WorkingSet, y: &Pairs, lambda: &Pairs, rho: f64) -> Estimate {
        let mut out = Estimate::default();
        for k in 0..PAIRS {
            let side = set.side[k];
            if side != 0.0 {
                let bound = if side > 0.0 {
                    self.upper[k]
                } else {
                    self.lower[k]
                };
                let e = rho.mul_add(y[k] - bound, lambda[k]);
                let (estimate, derivative) = if set.violated[k] {
                    let linear = side * self.linear[k];
                    let share = self.quadratic[k] / (rho + self.quadratic[k]);
                    (share.mul_add(e - linear, linear), share * rho)
                } else {
                    (e, rho)
                };
                (out.lambda[k], out.derivative[k]) = (estimate, derivative);
            }
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
