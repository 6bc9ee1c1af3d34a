//! The KKT residual of a solution, computed from the stages of [`OcpQp`] alone and thus independently of the solver.

use super::{OcpQp, OcpSolution, SoftRow};
use crate::qp::Penalty;
use crate::{Input, State};

/// Residual of the KKT conditions. All parts but `primal` are relative to the size of their terms (at least 1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KktResidual {
    /// Largest component of the Lagrangian's gradient in the inputs.
    pub stationarity: f64,
    /// Largest violation of a hard bound, in scaled units. Soft rows and dynamics hold by construction.
    pub primal: f64,
    /// Largest violation of the multipliers' sign: minus the most negative multiplier.
    pub dual: f64,
    /// Sum of |multiplier · distance to the bound|, which bounds the suboptimality of the cost.
    pub complementarity: f64,
}

impl Default for KktResidual {
    fn default() -> Self {
        Self {
            stationarity: f64::INFINITY,
            primal: f64::INFINITY,
            dual: f64::INFINITY,
            complementarity: f64::INFINITY,
        }
    }
}

impl KktResidual {
    /// The largest of the four; infinite if one of them is NaN.
    pub fn worst(&self) -> f64 {
        let parts = [
            self.stationarity,
            self.primal,
            self.dual,
            self.complementarity,
        ];
        if parts.iter().any(|p| p.is_nan()) {
            f64::INFINITY
        } else {
            parts.iter().fold(0.0, |m, p| f64::max(m, *p))
        }
    }
}

/// Maxima and sums over the stages.
#[derive(Default)]
struct Tally {
    gradient: f64,
    gradient_scale: f64,
    primal: f64,
    dual: f64,
    multiplier_scale: f64,
    complementarity: f64,
    cost: f64,
}

impl Tally {
    /// Adds an inequality `distance >= 0` with its multiplier.
    fn inequality(&mut self, multiplier: f64, distance: f64) {
        self.dual = max(self.dual, -multiplier);
        self.multiplier_scale = max(self.multiplier_scale, multiplier.abs());
        self.complementarity += (multiplier * distance).abs();
    }
}

/// Like `f64::max`, but NaN if either argument is: a residual must not hide NaN.
fn max(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() {
        f64::NAN
    } else {
        a.max(b)
    }
}

impl OcpQp {
    /// Rolls the states out from `solution.u`, then computes `solution.kkt` and `solution.cost`.
    ///
    /// Slacks are the violations of the soft rows, which is optimal for given states. The multipliers of the dynamics
    /// are the adjoint states `p_t = ∇_x + A_tᵀ p_{t+1}`, for which the gradient in the states is zero. The residual
    /// therefore consists of the gradient in the inputs, the hard bounds, the signs of the multipliers and the
    /// products.
    pub fn check(&self, solution: &mut OcpSolution) {
        self.roll_out(&solution.u, &mut solution.x);
        let mut tally = Tally::default();
        self.adjoint(solution, &mut tally);
        for t in 0..self.horizon() {
            self.check_stage(solution, t, &mut tally);
        }
        solution.cost = tally.cost;
        solution.kkt = KktResidual {
            stationarity: tally.gradient / tally.gradient_scale.max(1.0),
            primal: tally.primal,
            dual: tally.dual / tally.multiplier_scale.max(1.0),
            complementarity: tally.complementarity / tally.cost.max(1.0),
        };
    }

    /// Computes the adjoint states backwards; `adjoint[t+1]` is the multiplier of transition `t`.
    fn adjoint(&self, solution: &mut OcpSolution, tally: &mut Tally) {
        let horizon = self.horizon();
        for t in (0..horizon).rev() {
            let (stage, multipliers) = (&self.stages()[t], &solution.multipliers[t]);
            let x = &solution.x[t + 1];
            let error = x - stage.reference;
            let mut gradient = stage.q * error;
            tally.cost += 0.5 * error.dot(&gradient);
            for j in 0..self.n_soft() {
                let (lower, upper) = (multipliers.soft_lower[j], multipliers.soft_upper[j]);
                gradient += stage.soft[j].normal * (upper - lower);
                soft(&stage.soft[j], &self.penalty[j], x, lower, upper, tally);
            }
            if t + 1 < horizon {
                gradient += self.stages()[t + 1].a.tr_mul(&solution.adjoint[t + 2]);
            }
            solution.adjoint[t + 1] = gradient;
        }
    }

    fn check_stage(&self, solution: &OcpSolution, t: usize, tally: &mut Tally) {
        let (stage, multipliers) = (&self.stages()[t], &solution.multipliers[t]);
        let u = &solution.u[t];
        let du = u - self.previous(&solution.u, t);
        let state_part = stage.b.tr_mul(&solution.adjoint[t + 1]);
        let displacement = u - stage.planned;
        let cost_part = u.component_mul(&self.r)
            + displacement.component_mul(&stage.proximal)
            + du.component_mul(&self.r_d);
        let bound_part =
            multipliers.u_upper - multipliers.u_lower + multipliers.du_upper - multipliers.du_lower;
        let next_part = solution
            .multipliers
            .get(t + 1)
            .map_or_else(Input::zeros, |next| {
                let du_next = solution.u[t + 1] - u;
                next.du_lower - next.du_upper - du_next.component_mul(&self.r_d)
            });
        let gradient = state_part + cost_part + bound_part + next_part;
        tally.gradient = max(tally.gradient, largest(&gradient));
        for part in [&state_part, &cost_part, &bound_part, &next_part] {
            tally.gradient_scale = max(tally.gradient_scale, largest(part));
        }
        tally.cost += 0.5
            * (u.dot(&u.component_mul(&self.r))
                + displacement.dot(&displacement.component_mul(&stage.proximal))
                + du.dot(&du.component_mul(&self.r_d)));
        for i in 0..crate::NU {
            for (multiplier, distance) in [
                (multipliers.u_lower[i], u[i] - stage.u_min[i]),
                (multipliers.u_upper[i], stage.u_max[i] - u[i]),
                (multipliers.du_lower[i], du[i] - stage.du_min[i]),
                (multipliers.du_upper[i], stage.du_max[i] - du[i]),
            ] {
                tally.primal = max(tally.primal, -distance);
                tally.inequality(multiplier, distance);
            }
        }
    }
}

/// Adds a soft row: the slack follows from the state, and the multiplier of `s >= 0` from stationarity in the slack.
fn soft(row: &SoftRow, penalty: &Penalty, x: &State, lower: f64, upper: f64, tally: &mut Tally) {
    let value = row.normal.dot(x);
    let slack = max(max(row.lower - value, value - row.upper), 0.0);
    tally.cost += penalty.linear * slack + 0.5 * penalty.quadratic * slack * slack;
    tally.inequality(lower, value - row.lower + slack);
    tally.inequality(upper, row.upper - value + slack);
    tally.inequality(
        penalty.linear + penalty.quadratic * slack - lower - upper,
        slack,
    );
}

/// Largest absolute component; NaN if any component is NaN.
fn largest(v: &Input) -> f64 {
    v.iter().fold(0.0, |m, x| max(m, x.abs()))
}
