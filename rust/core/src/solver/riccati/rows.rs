//! The inequalities of one stage: values, slacks, multipliers and what they add to the LQ problem.
//!
//! Every row is two-sided, `lower ≤ a·w ≤ upper`, and is kept as two one-sided rows of sign `σ`,
//!
//! ```text
//! σ a·w − ε + s = b,   s ≥ 0, λ ≥ 0,   s λ → μ          (λ: multiplier of the row)
//! soft rows:  price ρ₁ ε + ½ ρ₂ ε²,   ε ≥ 0, γ ≥ 0,   ε γ → μ          (hard rows: ε = 0)
//! ```
//!
//! A Newton step eliminates `s, ε, γ` of each row on its own, which leaves
//! `Δλ = W (σ a·Δw + q)`: the row adds `W a aᵀ` to the Hessian and `σ a (λ + W q)` to the
//! gradient. Written without a division by `λ` or by `1/ε`, so that rows far from their bound and
//! rows exactly on it need no special case.

use super::band::Band;
use super::recursion::{Aug, Curvature};
use super::stage::{INPUT, PAIRS, row_curvature, row_gradient, row_values};
use crate::NU;

/// One-sided rows: all upper sides, then all lower sides.
pub(super) const ROWS: usize = 2 * PAIRS;
pub(super) type Rows = [f64; ROWS];

/// Slack a hard row starts with when its bounds leave no room inside.
const SMALLEST_SLACK: f64 = 0.01;

/// What the rows of a stage are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    /// `b`: upper bounds, then negated lower bounds; zero where a row is switched off.
    pub b: Rows,
    /// 1 for a row that exists, 0 for one that does not.
    pub on: Rows,
    /// 1 for a soft row that exists, 0 for any other.
    pub soft: Rows,
    /// `ρ₁`.
    pub linear: Rows,
    /// `ρ₂`.
    pub quadratic: Rows,
    /// Normal of the track row in the plane of positions.
    pub normal: [f64; 2],
}

/// The primal-dual iterate of a stage's rows. Rows that do not exist keep `s = 1, λ = 0`, rows that
/// are not soft `ε = 1, γ = 0`, so that no loop over rows needs a branch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Iterate {
    pub slack: Rows,
    pub lambda: Rows,
    pub epsilon: Rows,
    pub gamma: Rows,
}

/// What a factorisation needs of the rows; both right-hand sides of an iteration share it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scaling {
    /// `W`.
    pub weight: Rows,
    /// `1/(λ/D + s)`.
    stiffness: Rows,
    /// `1/D = 1/(ρ₂ + γ/ε)`, zero for hard rows.
    compliance: Rows,
    inverse_epsilon: Rows,
}

impl Default for Scaling {
    fn default() -> Self {
        let zero = [0.0; ROWS];
        Self {
            weight: zero,
            stiffness: zero,
            compliance: zero,
            inverse_epsilon: zero,
        }
    }
}

impl Scaling {
    /// The part of the elimination that depends on the targets.
    #[inline(always)]
    pub fn push(&self, it: &Iterate, r: &Residual, targets: &Targets, p: &mut Push) {
        for k in 0..ROWS {
            let drive = targets.second[k].mul_add(self.inverse_epsilon[k], -r.price[k]);
            let gap = self.compliance[k].mul_add(drive, r.primal[k]);
            p.shift[k] = self.stiffness[k] * it.lambda[k].mul_add(-gap, targets.first[k]);
            p.drive[k] = drive;
        }
    }
}

/// What one right-hand side adds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Push {
    /// `W q`.
    pub shift: Rows,
    /// `r₂/ε − r_ε`.
    pub drive: Rows,
}

/// `r_p = b − σ a·w + ε − s` and `r_ε = ρ₁ + ρ₂ ε − λ − γ`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Residual {
    pub primal: Rows,
    pub price: Rows,
}

/// Targets of complementarity, `s Δλ + λ Δs = first` and `ε Δγ + γ Δε = second`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Targets {
    pub first: Rows,
    pub second: Rows,
}

/// `a·w` of all pairs, repeated with the opposite sign for the lower sides.
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

impl Default for Bounds {
    fn default() -> Self {
        let zero = [0.0; ROWS];
        Self {
            b: zero,
            on: zero,
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

impl Bounds {
    /// The one-sided form of a stage's rows.
    pub fn of(band: &Band) -> Self {
        let mut out = Self {
            normal: band.normal,
            ..Self::default()
        };
        for k in 0..PAIRS {
            for (side, bound) in [(k, band.upper[k]), (PAIRS + k, -band.lower[k])] {
                if bound.is_finite() {
                    (out.b[side], out.on[side]) = (bound, 1.0);
                    if band.limit[k].is_finite() {
                        out.soft[side] = 1.0;
                        (out.linear[side], out.quadratic[side]) = (band.limit[k], band.beyond[k]);
                    }
                }
            }
        }
        out
    }

    /// Slacks, prices and multipliers on the central path for row values `y` and complementarity `mu`. For a soft row
    /// that is a quadratic in `ε`, once its price is taken at the violation.
    #[inline(always)]
    pub fn centred(&self, y: &Rows, mu: f64) -> Iterate {
        let mut it = Iterate::default();
        for k in 0..ROWS {
            let distance = self.b[k] - y[k];
            if self.soft[k] > 0.0 {
                let price = self.quadratic[k].mul_add((-distance).max(0.0), self.linear[k]);
                let (middle, reach) = (2.0 * mu, price * distance);
                let root = (middle * middle + reach * reach).sqrt();
                it.epsilon[k] = (middle - reach + root) / (2.0 * price);
                it.slack[k] = (middle + reach + root) / (2.0 * price);
                it.lambda[k] = mu / it.slack[k];
                it.gamma[k] = mu / it.epsilon[k];
            } else if self.on[k] > 0.0 {
                it.slack[k] = distance.max(SMALLEST_SLACK);
                it.lambda[k] = mu / it.slack[k];
            }
        }
        it
    }

    /// The control nearest to `v` that keeps a tenth of the width from each hard bound, the bounds
    /// on the input first and those on its rate last.
    #[inline(always)]
    pub fn inside(&self, v: &[f64; NU], u: &[f64; NU]) -> [f64; NU] {
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

    /// Residuals of the rows and of the prices at row values `y`; zero where there is none.
    #[inline(always)]
    pub fn residual(&self, y: &Rows, it: &Iterate, r: &mut Residual) {
        for k in 0..ROWS {
            let epsilon = self.soft[k] * it.epsilon[k];
            r.primal[k] = self.on[k] * (self.b[k] - y[k] + epsilon - it.slack[k]);
            let price = self.quadratic[k].mul_add(it.epsilon[k], self.linear[k]);
            r.price[k] = self.soft[k] * (price - it.lambda[k] - it.gamma[k]);
        }
    }

    /// Eliminates `Δs, Δε, Δγ`: the part that does not depend on the targets.
    #[inline(always)]
    pub fn scale(&self, it: &Iterate, c: &mut Scaling) {
        for k in 0..ROWS {
            c.inverse_epsilon[k] = 1.0 / it.epsilon[k];
            c.compliance[k] =
                self.soft[k] / it.gamma[k].mul_add(c.inverse_epsilon[k], self.quadratic[k]);
            c.stiffness[k] = self.on[k] / it.lambda[k].mul_add(c.compliance[k], it.slack[k]);
            c.weight[k] = it.lambda[k] * c.stiffness[k];
        }
    }

    /// The steps of all four quantities from the step of the row values.
    #[allow(clippy::too_many_arguments)] // a Newton step has as many parts
    #[inline(always)]
    pub fn recover(
        &self,
        c: &Scaling,
        p: &Push,
        it: &Iterate,
        r: &Residual,
        targets: &Targets,
        dy: &Rows,
        d: &mut Iterate,
    ) {
        for k in 0..ROWS {
            let lambda = c.weight[k].mul_add(dy[k], p.shift[k]);
            let epsilon = c.compliance[k] * (lambda + p.drive[k]);
            d.lambda[k] = lambda;
            d.epsilon[k] = epsilon;
            d.slack[k] = self.on[k] * (r.primal[k] - dy[k] + epsilon);
            d.gamma[k] =
                self.soft[k] * ((targets.second[k] - it.gamma[k] * epsilon) * c.inverse_epsilon[k]);
        }
    }

    /// Curvature `Σ W a aᵀ` on the next augmented state, and the rate part.
    #[inline(always)]
    pub fn curvature(&self, weight: &Rows) -> (Curvature, [f64; NU]) {
        let mut pair = [0.0; PAIRS];
        for k in 0..PAIRS {
            pair[k] = weight[k] + weight[PAIRS + k];
        }
        (row_curvature(&pair, &self.normal), [pair[0], pair[1]])
    }

    /// Gradient `Σ σ a f` in the next augmented state, and the rate part.
    #[inline(always)]
    pub fn gradient(&self, force: &Rows) -> (Aug, [f64; NU]) {
        let mut pair = [0.0; PAIRS];
        for k in 0..PAIRS {
            pair[k] = force[k] - force[PAIRS + k];
        }
        (row_gradient(&pair, &self.normal), [pair[0], pair[1]])
    }

    /// Adds `s λ + ε γ` of each row to `sums`, after a step of that length.
    #[inline(always)]
    pub fn add_products(&self, it: &Iterate, length: f64, step: &Iterate, sums: &mut Rows) {
        for k in 0..ROWS {
            let slack = length.mul_add(step.slack[k], it.slack[k]);
            let lambda = length.mul_add(step.lambda[k], it.lambda[k]);
            let epsilon = length.mul_add(step.epsilon[k], it.epsilon[k]);
            let gamma = length.mul_add(step.gamma[k], it.gamma[k]);
            sums[k] += self.on[k] * slack * lambda + self.soft[k] * epsilon * gamma;
        }
    }

    /// The number of products in these sums.
    pub fn products(&self) -> f64 {
        self.on.iter().sum::<f64>() + self.soft.iter().sum::<f64>()
    }

    /// Raises `worst` to the relative rate of decrease of each row's slacks and multipliers, `max −Δ/value`.
    #[inline(always)]
    pub fn raise_decrease(&self, it: &Iterate, step: &Iterate, worst: &mut Rows) {
        for k in 0..ROWS {
            // One division for two; rows that do not exist have multipliers, and steps, of zero.
            let hard = 1.0 / (it.slack[k] * it.lambda[k] + (1.0 - self.on[k]));
            let soft = 1.0 / (it.epsilon[k] * it.gamma[k] + (1.0 - self.soft[k]));
            let ratios = [
                -step.slack[k] * it.lambda[k] * hard,
                -step.lambda[k] * it.slack[k] * hard,
                -step.epsilon[k] * it.gamma[k] * soft,
                -step.gamma[k] * it.epsilon[k] * soft,
            ];
            let hard = self.on[k] * larger(ratios[0], ratios[1]);
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

/// The largest of all rows, zero at least.
#[inline(always)]
pub(super) fn largest(rows: &Rows) -> f64 {
    rows.iter().fold(0.0, |a, b| larger(a, *b))
}

impl Iterate {
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
    /// The predictor's: complementarity zero.
    #[inline(always)]
    pub fn affine(it: &Iterate) -> Self {
        let mut t = Self {
            first: [0.0; ROWS],
            second: [0.0; ROWS],
        };
        for k in 0..ROWS {
            t.first[k] = -it.slack[k] * it.lambda[k];
            t.second[k] = -it.epsilon[k] * it.gamma[k];
        }
        t
    }

    /// The corrector's: complementarity `mu`, second-order term of the predictor included.
    #[inline(always)]
    pub fn corrected(it: &Iterate, step: &Iterate, mu: f64) -> Self {
        let mut t = Self {
            first: [0.0; ROWS],
            second: [0.0; ROWS],
        };
        for k in 0..ROWS {
            t.first[k] = mu - it.slack[k].mul_add(it.lambda[k], step.slack[k] * step.lambda[k]);
            t.second[k] = mu - it.epsilon[k].mul_add(it.gamma[k], step.epsilon[k] * step.gamma[k]);
        }
        t
    }
}
