//! The rows of a stage as the active set sees them: two-sided, one signed multiplier a row.
//!
//! A row `lower <= y <= upper` enters the augmented Lagrangian through its force (the derivative in `y`)
//!
//! ```text
//! e = max(λ + ρ (y − upper), 0) + min(λ + ρ (y − lower), 0)
//! f = e                                        for |e| <= ρ₁   (hard rows: ρ₁ = ∞)
//!     sign(e) (ρ₁ + ρ₂/(ρ + ρ₂) (|e| − ρ₁))    beyond
//! ```
//!
//! the second line being the proximal form of the price `ρ₁ s + ½ ρ₂ s²` (Rockafellar, *Math. Oper. Res.* 1, 1976). At
//! a fixed point `f = λ` it is the exact multiplier, whatever `ρ`.

use super::stage::PAIRS;
use crate::settings::Penalty;

pub(super) type Pairs = [f64; PAIRS];

/// Rows of a stage; those that do not exist have infinite bounds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Band {
    pub lower: Pairs,
    pub upper: Pairs,
    /// `ρ₁`.
    pub limit: Pairs,
    /// `ρ₂`; the row's own stiffness once its force is at the limit.
    pub beyond: Pairs,
    /// Normal of the track row in the plane of positions.
    pub normal: [f64; 2],
}

impl Default for Band {
    fn default() -> Self {
        Self {
            lower: [f64::NEG_INFINITY; PAIRS],
            upper: [f64::INFINITY; PAIRS],
            limit: [f64::INFINITY; PAIRS],
            beyond: [0.0; PAIRS],
            normal: [0.0; 2],
        }
    }
}

impl Band {
    /// Row `k` must lie within `lower..=upper`.
    pub fn hard(&mut self, k: usize, lower: f64, upper: f64) {
        (self.lower[k], self.upper[k]) = (lower, upper);
    }

    /// Row `k` should lie within `lower..=upper`, at that price.
    pub fn soft(&mut self, k: usize, lower: f64, upper: f64, penalty: Penalty) {
        self.hard(k, lower, upper);
        (self.limit[k], self.beyond[k]) = (penalty.linear, penalty.quadratic);
    }
}

/// Forces of the rows and their derivatives in the row values.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Response {
    pub force: Pairs,
    pub weight: Pairs,
}

impl Band {
    /// The response at row values `y` and multipliers `lambda`, for stiffness `rho`.
    #[inline(always)]
    pub fn response(&self, y: &Pairs, lambda: &Pairs, rho: f64) -> Response {
        let mut out = Response::default();
        for k in 0..PAIRS {
            let above = rho.mul_add(y[k] - self.upper[k], lambda[k]);
            let below = rho.mul_add(y[k] - self.lower[k], lambda[k]);
            let above = if above > 0.0 { above } else { 0.0 };
            let below = if below < 0.0 { below } else { 0.0 };
            let e = above + below;
            let size = e.abs();
            let over = size - self.limit[k];
            let share = self.beyond[k] / (rho + self.beyond[k]);
            let soft = over > 0.0;
            let force = if soft {
                share.mul_add(over, self.limit[k])
            } else {
                size
            };
            let weight = if soft { share * rho } else { rho };
            out.force[k] = force.copysign(e);
            out.weight[k] = if size > 0.0 { weight } else { 0.0 };
        }
        out
    }

    /// The response of rows taken to press: as if beyond the bound, wherever `y` is.
    #[inline(always)]
    pub fn taken(&self, y: &Pairs, lambda: &Pairs, pressing: &Pressing, rho: f64) -> Response {
        let mut out = Response::default();
        for k in 0..PAIRS {
            let side = pressing.side[k];
            if side != 0.0 {
                let bound = if side > 0.0 {
                    self.upper[k]
                } else {
                    self.lower[k]
                };
                let e = rho.mul_add(y[k] - bound, lambda[k]);
                let (force, weight) = if pressing.yielding[k] {
                    let limit = side * self.limit[k];
                    let share = self.beyond[k] / (rho + self.beyond[k]);
                    (share.mul_add(e - limit, limit), share * rho)
                } else {
                    (e, rho)
                };
                (out.force[k], out.weight[k]) = (force, weight);
            }
        }
        out
    }
}

/// A guess of which rows press.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pressing {
    /// 1 at the upper bound, -1 at the lower, 0 at none.
    pub side: Pairs,
    /// The price of the row is paid: its force is beyond `ρ₁`.
    pub yielding: [bool; PAIRS],
}
