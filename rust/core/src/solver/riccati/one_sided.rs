//! The inequality rows of a stage in the form of the interior-point method: one-sided, with slacks and multipliers.
//!
//! Every row is two-sided, `lower ≤ a·w ≤ upper`, and is split into two one-sided rows of sign `σ`,
//!
//! ```text
//! σ a·w − ε + s = b,   s ≥ 0, λ ≥ 0,   s λ → μ          (λ: multiplier of the row)
//! soft rows:  penalty ρ₁ ε + ½ ρ₂ ε²,   ε ≥ 0, γ ≥ 0,   ε γ → μ          (hard rows: ε = 0)
//! ```
//!
//! A Newton step eliminates `s, ε, γ` row by row, which leaves `Δλ = W (σ a·Δw + q)`: the row adds `W a aᵀ` to the
//! Hessian and `σ a (λ + W q)` to the gradient of the LQ problem. The formulas divide neither by `λ` nor by `1/ε`, so
//! that rows far from their bound and rows exactly on it need no special case.

use super::recursion::{Aug, Curvature};
use super::stage::{INPUT, PAIRS, row_curvature, row_gradient, row_values};
use super::two_sided::TwoSided;
use crate::NU;

/// One-sided rows: all upper sides, then all lower sides.
pub(super) const ROWS: usize = 2 * PAIRS;
pub(super) type Rows = [f64; ROWS];

/// Smallest initial slack of a hard row.
const SMALLEST_SLACK: f64 = 0.01;

/// Rows of a stage.
#[derive(Clone, Copy, Debug)]
pub(super) struct OneSided {
    /// `b`: upper bounds, then negated lower bounds; zero for absent rows.
    pub b: Rows,
    /// 1 for a present row, 0 for an absent one.
    pub present: Rows,
    /// 1 for a present soft row, 0 for any other.
    pub soft: Rows,
    /// `ρ₁`.
    pub linear: Rows,
    /// `ρ₂`.
    pub quadratic: Rows,
    /// Normal of the track row in the plane of positions.
    pub normal: [f64; 2],
}

/// Primal-dual iterate of a stage's rows. Absent rows keep `s = 1, λ = 0` and rows that are not soft keep
/// `ε = 1, γ = 0`, so that no loop over rows needs a branch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Iterate {
    pub slack: Rows,
    pub lambda: Rows,
    pub epsilon: Rows,
    pub gamma: Rows,
}

/// Coefficients of the elimination that depend on the iterate alone; both right-hand sides of an iteration use them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Scaling {
    /// `W`.
    pub weight: Rows,
    /// `1/(λ/D + s)`.
    inverse_pivot: Rows,
    /// `1/D = 1/(ρ₂ + γ/ε)`, zero for hard rows.
    inverse_d: Rows,
    inverse_epsilon: Rows,
}

impl Scaling {
    /// Eliminates `Δs, Δε, Δγ`: the terms that depend on the targets.
    #[inline(always)]
    pub fn right_hand_side(
        &self,
        it: &Iterate,
        r: &Residual,
        targets: &Targets,
        rhs: &mut RightHandSide,
    ) {
        for k in 0..ROWS {
            let epsilon = targets.second[k].mul_add(self.inverse_epsilon[k], -r.epsilon[k]);
            let gap = self.inverse_d[k].mul_add(epsilon, r.primal[k]);
            rhs.lambda[k] = self.inverse_pivot[k] * it.lambda[k].mul_add(-gap, targets.first[k]);
            rhs.epsilon[k] = epsilon;
        }
    }
}

/// Terms of the elimination that depend on the targets.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RightHandSide {
    /// `W q`.
    pub lambda: Rows,
    /// `second/ε − r_ε`.
    pub epsilon: Rows,
}

/// `r_p = b − σ a·w + ε − s` and `r_ε = ρ₁ + ρ₂ ε − λ − γ`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Residual {
    pub primal: Rows,
    pub epsilon: Rows,
}

/// Right-hand sides of the linearised complementarity conditions, `s Δλ + λ Δs = first` and `ε Δγ + γ Δε = second`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Targets {
    pub first: Rows,
    pub second: Rows,
}

/// The values `σ a·w` of all one-sided rows.
#[inline(always)]
pub(super) fn signed_values(v: &[f64; NU], s: &Aug, normal: &[f64; 2]) -> Rows {
    let values = row_values(v, s, normal);
    let mut y = [0.0; ROWS];
    for k in 0..PAIRS {
        y[k] = values[k];
        y[PAIRS + k] = -values[k];
    }
    y
}

impl Default for OneSided {
    fn default() -> Self {
        let zero = [0.0; ROWS];
        Self {
            b: zero,
            present: zero,
            soft: zero,
            linear: zero,
            quadratic: [1.0; ROWS],
            normal: [0.0; 2],
        }
    }
}

impl Default for Iterate {
    fn default() -> Self {
        let (zero, one) = ([0.0; ROWS], [1.0; ROWS]);
        Self {
            slack: one,
            lambda: zero,
            epsilon: one,
            gamma: zero,
        }
    }
}

impl OneSided {
    /// The one-sided form of a stage's rows.
    pub fn of(rows: &TwoSided) -> Self {
        let mut out = Self {
            normal: rows.normal,
            ..Self::default()
        };
        for k in 0..PAIRS {
            for (side, bound) in [(k, rows.upper[k]), (PAIRS + k, -rows.lower[k])] {
                if bound.is_finite() {
                    (out.b[side], out.present[side]) = (bound, 1.0);
                    if rows.linear[k].is_finite() {
                        out.soft[side] = 1.0;
                        (out.linear[side], out.quadratic[side]) =
                            (rows.linear[k], rows.quadratic[k]);
                    }
                }
            }
        }
        out
    }

    /// The iterate on the central path for row values `y` and barrier parameter `mu`. For a soft row this is the root
    /// of a quadratic in `ε`, with the derivative of the penalty taken at the present violation.
    #[inline(always)]
    pub fn centred(&self, y: &Rows, mu: f64) -> Iterate {
        let mut it = Iterate::default();
        for k in 0..ROWS {
            let distance = self.b[k] - y[k];
            if self.soft[k] > 0.0 {
                let slope = self.quadratic[k].mul_add((-distance).max(0.0), self.linear[k]);
                let (middle, reach) = (2.0 * mu, slope * distance);
                let root = (middle * middle + reach * reach).sqrt();
                it.epsilon[k] = (middle - reach + root) / (2.0 * slope);
                it.slack[k] = (middle + reach + root) / (2.0 * slope);
                it.lambda[k] = mu / it.slack[k];
                it.gamma[k] = mu / it.epsilon[k];
            } else if self.present[k] > 0.0 {
                it.slack[k] = distance.max(SMALLEST_SLACK);
                it.lambda[k] = mu / it.slack[k];
            }
        }
        it
    }

    /// The control nearest to `v` that keeps a tenth of the interval's width from each hard bound. The bounds on the
    /// rate take precedence over the bounds on the input.
    #[inline(always)]
    pub fn interior_control(&self, v: &[f64; NU], u: &[f64; NU]) -> [f64; NU] {
        let within = |k: usize, value: f64| {
            let (lower, upper) = (-self.b[PAIRS + k], self.b[k]);
            let room = 0.1 * (upper - lower);
            value.max(lower + room).min(upper - room)
        };
        let mut out = *v;
        for i in 0..NU {
            out[i] = within(i, within(INPUT + i, u[i] + v[i]) - u[i]);
        }
        out
    }

    /// Residuals at row values `y`; zero for absent rows.
    #[inline(always)]
    pub fn residual(&self, y: &Rows, it: &Iterate, r: &mut Residual) {
        for k in 0..ROWS {
            let epsilon = self.soft[k] * it.epsilon[k];
            r.primal[k] = self.present[k] * (self.b[k] - y[k] + epsilon - it.slack[k]);
            let slope = self.quadratic[k].mul_add(it.epsilon[k], self.linear[k]);
            r.epsilon[k] = self.soft[k] * (slope - it.lambda[k] - it.gamma[k]);
        }
    }

    /// Eliminates `Δs, Δε, Δγ`: the coefficients that depend on the iterate alone.
    #[inline(always)]
    pub fn scale(&self, it: &Iterate, c: &mut Scaling) {
        for k in 0..ROWS {
            c.inverse_epsilon[k] = 1.0 / it.epsilon[k];
            c.inverse_d[k] =
                self.soft[k] / it.gamma[k].mul_add(c.inverse_epsilon[k], self.quadratic[k]);
            c.inverse_pivot[k] =
                self.present[k] / it.lambda[k].mul_add(c.inverse_d[k], it.slack[k]);
            c.weight[k] = it.lambda[k] * c.inverse_pivot[k];
        }
    }

    /// Recovers the steps of slacks, multipliers, `ε` and `γ` from the step of the row values.
    #[allow(clippy::too_many_arguments)] // a Newton step has as many parts
    #[inline(always)]
    pub fn recover(
        &self,
        c: &Scaling,
        rhs: &RightHandSide,
        it: &Iterate,
        r: &Residual,
        targets: &Targets,
        dy: &Rows,
        d: &mut Iterate,
    ) {
        for k in 0..ROWS {
            let lambda = c.weight[k].mul_add(dy[k], rhs.lambda[k]);
            let epsilon = c.inverse_d[k] * (lambda + rhs.epsilon[k]);
            d.lambda[k] = lambda;
            d.epsilon[k] = epsilon;
            d.slack[k] = self.present[k] * (r.primal[k] - dy[k] + epsilon);
            d.gamma[k] =
                self.soft[k] * ((targets.second[k] - it.gamma[k] * epsilon) * c.inverse_epsilon[k]);
        }
    }

    /// Hessian `Σ W a aᵀ` in the next augmented state, and in the rate.
    #[inline(always)]
    pub fn curvature(&self, weight: &Rows) -> (Curvature, [f64; NU]) {
        let mut pair = [0.0; PAIRS];
        for k in 0..PAIRS {
            pair[k] = weight[k] + weight[PAIRS + k];
        }
        (row_curvature(&pair, &self.normal), [pair[0], pair[1]])
    }

    /// Gradient `Σ σ a λ` in the next augmented state, and in the rate.
    #[inline(always)]
    pub fn gradient(&self, lambda: &Rows) -> (Aug, [f64; NU]) {
        let mut pair = [0.0; PAIRS];
        for k in 0..PAIRS {
            pair[k] = lambda[k] - lambda[PAIRS + k];
        }
        (row_gradient(&pair, &self.normal), [pair[0], pair[1]])
    }

    /// Adds `s λ + ε γ` of each row to `sums`.
    #[inline(always)]
    pub fn add_products(&self, it: &Iterate, sums: &mut Rows) {
        for k in 0..ROWS {
            sums[k] += self.present[k] * it.slack[k] * it.lambda[k]
                + self.soft[k] * it.epsilon[k] * it.gamma[k];
        }
    }

    /// Number of complementary pairs `s, λ` and `ε, γ`.
    pub fn n_pairs(&self) -> f64 {
        self.present.iter().sum::<f64>() + self.soft.iter().sum::<f64>()
    }

    /// Raises `worst` to the largest relative decrease `−Δ/value` of each row's slacks and multipliers.
    #[inline(always)]
    pub fn max_decrease(&self, it: &Iterate, step: &Iterate, worst: &mut Rows) {
        for k in 0..ROWS {
            // One division serves two ratios; absent rows have multipliers and steps of zero.
            let hard = 1.0 / (it.slack[k] * it.lambda[k] + (1.0 - self.present[k]));
            let soft = 1.0 / (it.epsilon[k] * it.gamma[k] + (1.0 - self.soft[k]));
            let ratios = [
                -step.slack[k] * it.lambda[k] * hard,
                -step.lambda[k] * it.slack[k] * hard,
                -step.epsilon[k] * it.gamma[k] * soft,
                -step.gamma[k] * it.epsilon[k] * soft,
            ];
            let hard = self.present[k] * larger(ratios[0], ratios[1]);
            let soft = self.soft[k] * larger(ratios[2], ratios[3]);
            worst[k] = larger(worst[k], larger(hard, soft));
        }
    }
}

/// The larger of two numbers in one instruction; `b` where one is NaN.
#[inline(always)]
pub(super) fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The largest entry, at least zero.
#[inline(always)]
pub(super) fn largest(rows: &Rows) -> f64 {
    rows.iter().fold(0.0, |a, b| larger(a, *b))
}

impl Iterate {
    /// A direction that changes nothing.
    pub const ZERO: Self = Self {
        slack: [0.0; ROWS],
        lambda: [0.0; ROWS],
        epsilon: [0.0; ROWS],
        gamma: [0.0; ROWS],
    };

    /// Takes a step of that length.
    #[inline(always)]
    pub fn advance(&mut self, length: f64, step: &Self) {
        for k in 0..ROWS {
            self.slack[k] = length.mul_add(step.slack[k], self.slack[k]);
            self.lambda[k] = length.mul_add(step.lambda[k], self.lambda[k]);
            self.epsilon[k] = length.mul_add(step.epsilon[k], self.epsilon[k]);
            self.gamma[k] = length.mul_add(step.gamma[k], self.gamma[k]);
        }
    }
}

impl Targets {
    /// Targets of the predictor: complementarity zero.
    #[inline(always)]
    pub fn affine(it: &Iterate) -> Self {
        let mut t = Self::default();
        for k in 0..ROWS {
            t.first[k] = -it.slack[k] * it.lambda[k];
            t.second[k] = -it.epsilon[k] * it.gamma[k];
        }
        t
    }

    /// Targets of the corrector: complementarity `mu` less the second-order term of the predictor.
    #[inline(always)]
    pub fn corrected(it: &Iterate, step: &Iterate, mu: f64) -> Self {
        let mut t = Self::default();
        for k in 0..ROWS {
            t.first[k] = mu - it.slack[k].mul_add(it.lambda[k], step.slack[k] * step.lambda[k]);
            t.second[k] = mu - it.epsilon[k].mul_add(it.gamma[k], step.epsilon[k] * step.gamma[k]);
        }
        t
    }
}
