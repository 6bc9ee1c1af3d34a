//! Weights, eq. (6): the blend of members that explains the last transitions best.
//!
//! ```text
//! w = argmin ||S (Y - F w)||² + prior(w - w_prev)   on the simplex
//! ```
//!
//! `Y` are the measured changes of the last `K` periods, and column `n` of `F` contains the predictions of member `n`
//! for them. `SᵀS` is the inverse covariance of the errors ([`WindowNoise`]). It makes m/s and rad/s comparable and
//! accounts for the noise of the measured states, which enters consecutive changes with opposite signs.

mod active_set;
mod best_subset;
mod gram;
mod noise;

pub use noise::WindowNoise;
pub(crate) use noise::{blend_error, model_std, state_std};

use active_set::{SimplexQp, SimplexSolver};
use best_subset::best_subset;
use gram::Gram;
use noise::Row;

use crate::NY;
use crate::settings::Prior;

/// Ridge on `H` relative to its largest diagonal entry, which counts as at least 1. With identical members and no quadratic
/// prior it selects the minimiser nearest to the previous weights.
const RIDGE: f64 = 1e-10;

/// Reciprocal of the power of likelihoods, because a model's errors are similar from one period to the next. Only its product
/// with [`INFORMED`] matters, and both were chosen together. The friction's posterior has a value of its own, which is
/// calibrated by the coverage of its interval.
const TEMPERATURE: f64 = 3.0;

/// Log-likelihood difference in nats above which a window distinguishes the members. With 1.0 the weights settle more than 0.5
/// s after a step of the friction at 2 m/s² of lateral acceleration.
const INFORMED: f64 = 0.25;

/// Estimator of the weights of `N` members, with its memory.
#[derive(Debug, Clone)]
pub struct WeightEstimator {
    /// `S [F Y]`: a row for each output of each transition, the members' predictions before the measurement.
    whitened: Gram,
    hessian: Vec<f64>,
    linear: Vec<f64>,
    solver: SimplexSolver,
}

impl WeightEstimator {
    /// An estimator for `n` members, with memory for `window` transitions.
    pub fn new(n: usize, window: usize) -> Self {
        Self {
            whitened: Gram::new(n + 1, window * NY),
            hessian: vec![0.0; n * n],
            linear: vec![0.0; n],
            solver: SimplexSolver::new(n),
        }
    }

    /// Writes the weights, eq. (6), to `w`; they are on the simplex up to rounding.
    ///
    /// * `predictions`: rows `[N * 3]` of `F`, one for each of consecutive transitions, newest or oldest first,
    ///   member after member
    /// * `measured`: rows `[3]` of `Y`
    /// * `noise`: covariances of the errors, of which the one with the largest likelihood for the errors of `previous`
    ///   is used; transitions beyond its window are ignored
    /// * `previous`: `w_prev`, on the simplex
    ///
    /// Without transitions the weights equal `previous`. Returns the solver's iterations, or `None` if rounding errors prevent
    /// that it ends; the weights are then on the simplex and no worse than `previous`.
    pub fn estimate(
        &mut self,
        predictions: &[f64],
        measured: &[[f64; NY]],
        noise: &WindowNoise,
        prior: Prior,
        previous: &[f64],
        w: &mut [f64],
    ) -> Option<usize> {
        let n = previous.len();
        w.copy_from_slice(previous);
        self.whitened.clear();
        let transitions = predictions.chunks_exact(n * NY).zip(measured);
        let rows = noise.rows(predictions, measured, previous);
        for ((row, y), whitening) in transitions.zip(rows) {
            self.add_transition(row, y, whitening);
        }
        self.whitened.multiply();
        let products = |i| {
            self.whitened
                .products(i)
                .iter()
                .map(|product| 2.0 * product)
        };
        for (i, row) in self.hessian.chunks_exact_mut(n).enumerate() {
            row.iter_mut().zip(products(i)).for_each(|(h, p)| *h = p);
        }
        for (linear, product) in self.linear.iter_mut().zip(products(n)) {
            *linear = -product;
        }
        let (lambda, alpha) = match prior {
            Prior::Quadratic { lambda } => (lambda, 0.0),
            Prior::L1 { alpha } => (0.0, alpha),
        };
        let largest = (0..n).map(|i| self.hessian[i * n + i]).fold(1.0, f64::max);
        let ridge = 2.0 * lambda + RIDGE * largest;
        for (i, w_prev) in previous.iter().enumerate() {
            self.hessian[i * n + i] += ridge;
            self.linear[i] -= ridge * w_prev;
        }
        let qp = SimplexQp {
            hessian: &self.hessian,
            linear: &self.linear,
            centre: previous,
            alpha,
        };
        self.solver.solve(&qp, w)
    }

    /// Replaces the weights `w` of the last [`Self::estimate`] by those of one or two members if these explain the window
    /// nearly as well: it minimises the cost of eq. (6) plus a constant for each member with a positive weight, over `w`, all
    /// single members and all blends of two. The constant is `penalty` nats of the log-likelihood that [`Self::informed`]
    /// uses. A penalty above 0 needs whitened errors and the quadratic prior; 0 changes nothing.
    ///
    /// With members of very different surfaces several blends predict nearly the same changes in a window, one of them with
    /// the true member alone, and they differ in what they predict for other slips. The weights of eq. (6) then follow the
    /// noise, and a seventh of snow in a blend with ice raises the friction by 29 %. The choice of few terms by a penalised
    /// misfit is best subset selection (Hastie, Tibshirani and Friedman, *The Elements of Statistical Learning*, 2nd edition,
    /// section 3.3).
    pub fn select(&self, penalty: f64, w: &mut [f64]) {
        if penalty > 0.0 {
            let scale = 2.0 * TEMPERATURE * self.misfit(self.of_weights(w));
            best_subset(&self.hessian, &self.linear, penalty * scale, w);
        }
    }

    /// Whether the last window distinguishes the members: the log-likelihood of the worst member is at least `INFORMED` nats
    /// below that of the weights `w`. Likelihoods have the exponent `1 / (TEMPERATURE max(1, J / n))`, where `J` is the sum
    /// of the `n` squared whitened errors under `w` (`docs/problem.md`, section 4). The last call of [`Self::estimate`] must
    /// have used whitened errors, because log-likelihoods are compared.
    pub fn informed(&self, w: &[f64]) -> bool {
        let of_member = |i: usize| {
            let products = self.whitened.products(i);
            products[i] - 2.0 * products[w.len()]
        };
        let worst = (0..w.len())
            .map(of_member)
            .fold(f64::NEG_INFINITY, f64::max);
        let of_weights = self.of_weights(w);
        worst - of_weights >= 2.0 * INFORMED * TEMPERATURE * self.misfit(of_weights)
    }

    /// The sum of the squared whitened errors of the last window under the weights `w`, less that of the measurements.
    fn of_weights(&self, w: &[f64]) -> f64 {
        let n = w.len();
        (0..n)
            .map(|i| {
                let products = self.whitened.products(i);
                let row: f64 = w.iter().zip(products).map(|(w, product)| w * product).sum();
                w[i] * (row - 2.0 * products[n])
            })
            .sum()
    }

    /// `max(1, J / n)` of the last window, from the result of [`Self::of_weights`].
    fn misfit(&self, of_weights: f64) -> f64 {
        let n = self.linear.len();
        let squares = self.whitened.products(n)[n] + of_weights;
        (squares / self.whitened.row_count().max(1) as f64).max(1.0)
    }

    /// Adds the rows of a transition to `S [F Y]`.
    fn add_transition(&mut self, predicted: &[f64], measured: &[f64; NY], whitening: &Row) {
        for output in 0..NY {
            let raw = predicted.as_chunks::<NY>().0.iter().chain([measured]);
            for (whitened, raw) in self.whitened.repeat(NY).iter_mut().zip(raw) {
                *whitened = whitening.whiten(output, raw[output], *whitened);
            }
        }
    }
}

/// Writes the largest `max_active` weights above `threshold`, scaled to sum to 1, to `active`; the other entries are
/// zero. The largest weight is always kept. Returns the sum of the dropped weights. `weights` must be on the simplex, and
/// `max_active` at least 1.
pub(crate) fn select_active(
    weights: &[f64],
    threshold: f64,
    max_active: usize,
    active: &mut [f64],
) -> f64 {
    active.fill(0.0);
    let mut kept = 0.0;
    for rank in 0..max_active.min(weights.len()) {
        let heaviest = (0..weights.len())
            .filter(|&i| active[i] == 0.0 && (rank == 0 || weights[i] > threshold))
            .reduce(|best, i| if weights[i] > weights[best] { i } else { best });
        let Some(i) = heaviest else { break };
        active[i] = weights[i];
        kept += weights[i];
    }
    for w in active.iter_mut() {
        *w /= kept;
    }
    (1.0 - kept).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn selection_keeps_the_largest_weights() {
        let mut active = [0.0; 4];
        let dropped = select_active(&[0.5, 0.0004, 0.2996, 0.2], 1e-3, 2, &mut active);
        assert!((dropped - 0.2004).abs() < 1e-15);
        assert_eq!(active[1] + active[3], 0.0);
        assert!((active.iter().sum::<f64>() - 1.0).abs() < 1e-15 && active[0] > active[2]);
        let uniform = [0.25; 4];
        assert_eq!(select_active(&uniform, 0.0999, 8, &mut active), 0.0);
        assert_eq!(active, uniform);
    }
}
