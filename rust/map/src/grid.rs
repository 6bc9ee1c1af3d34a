//! Probabilities of friction coefficients.

use egp_parameters::{FRICTION_HYPOTHESES, FRICTION_RANGE, interpolate_hypotheses};

/// Number of friction coefficients between two hypotheses of the control step, that of one of them included.
const FINER: usize = 3;
/// Number of friction coefficients, equidistant in `ln mu`.
pub(crate) const LEVELS: usize = (FRICTION_HYPOTHESES - 1) * FINER + 1;

/// A probability, a likelihood or its logarithm for each friction coefficient.
pub(crate) type Row = [f64; LEVELS];

/// The intervals of friction that the coefficients stand for: their ends lie halfway between two coefficients.
#[derive(Debug, Clone)]
pub(crate) struct Grid {
    /// Lower end of each interval, and the upper end of the last.
    edges: [f64; LEVELS + 1],
    /// Probability of each interval before anything is known: uniform over the range of friction.
    pub prior: Row,
}

impl Grid {
    pub fn new() -> Self {
        let (low, high) = FRICTION_RANGE;
        let gap = (high / low).ln() / (LEVELS - 1) as f64;
        let edges = std::array::from_fn(|i| match i {
            0 => low,
            LEVELS => high,
            _ => low * ((i as f64 - 0.5) * gap).exp(),
        });
        let prior = std::array::from_fn(|i| (edges[i + 1] - edges[i]) / (high - low));
        Self { edges, prior }
    }

    /// Median and standard deviation of the friction, for `masses` that need not sum to one.
    pub fn median_and_std(&self, masses: &Row) -> [f64; 2] {
        let (mut sum, mut mean, mut square) = (0.0, 0.0, 0.0);
        for (i, mass) in masses.iter().enumerate() {
            let middle = f64::midpoint(self.edges[i], self.edges[i + 1]);
            sum += mass;
            mean += mass * middle;
            square += mass * middle * middle;
        }
        let variance = square / sum - (mean / sum).powi(2);
        [self.quantile(masses, 0.5), variance.max(0.0).sqrt()]
    }

    /// The friction below which the probability is `share`, for `masses` that need not sum to one.
    pub fn quantile(&self, masses: &Row, share: f64) -> f64 {
        let mut left = share * masses.iter().sum::<f64>();
        for (i, mass) in masses.iter().enumerate() {
            if left < *mass {
                return self.edges[i] + left / mass * (self.edges[i + 1] - self.edges[i]);
            }
            left -= mass;
        }
        self.edges[LEVELS]
    }
}

/// Logarithms of the likelihoods of all coefficients, from those of the hypotheses.
pub(crate) fn interpolate(hypotheses: &[f64; FRICTION_HYPOTHESES]) -> Row {
    std::array::from_fn(|i| interpolate_hypotheses(hypotheses, i as f64 / FINER as f64))
}

/// Divides by the largest value, so that products of many rows neither overflow nor vanish.
pub(crate) fn normalise(row: &mut Row) {
    let most = row.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let scale = most.recip();
    for value in row {
        *value *= scale;
    }
}

/// Divides by the sum.
pub(crate) fn to_probabilities(row: &mut Row) {
    let scale = row.iter().sum::<f64>().max(f64::MIN_POSITIVE).recip();
    for value in row {
        *value *= scale;
    }
}
