//! Probabilities of friction coefficients.

use egp_parameters::{FRICTION_HYPOTHESES, FRICTION_RANGE, interpolate_hypotheses};

/// Number of intervals of the grid between two neighbouring hypotheses of the control step.
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

    /// Returns the masses and their sum. If the sum is zero or not finite, the prior takes their place.
    fn known<'a>(&'a self, masses: &'a Row) -> (&'a Row, f64) {
        let sum: f64 = masses.iter().sum();
        if sum > 0.0 && sum.is_finite() {
            (masses, sum)
        } else {
            (&self.prior, self.prior.iter().sum())
        }
    }

    /// Median and standard deviation of the friction, for `masses` that need not sum to one.
    pub fn median_and_std(&self, masses: &Row) -> [f64; 2] {
        let (masses, _) = self.known(masses);
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
        let (masses, sum) = self.known(masses);
        let mut left = share * sum;
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

/// Interpolates log likelihoods, of which that of the likeliest hypothesis is 0. Values above `-indifference` become 0, also those
/// that the interpolation puts above 0 between two hypotheses; the others are raised by `indifference`.
pub(crate) fn interpolate_with_dead_zone(
    hypotheses: &[f64; FRICTION_HYPOTHESES],
    indifference: f64,
) -> Row {
    interpolate(hypotheses).map(|value| (value + indifference).min(0.0))
}

/// Divides a row by its sum.
pub(crate) fn to_probabilities(row: &mut Row) {
    let scale = one_over_sum(row);
    for value in row {
        *value *= scale;
    }
}

/// Divides a row by its sum, and mixes in, with the probability `share`, probabilities that are proportional to `likelihood`
/// times `prior`. If this product is zero everywhere, the prior is mixed in.
pub(crate) fn mix(row: &mut Row, likelihood: &Row, prior: &Row, share: f64) {
    let (rows, row_rest) = row.as_chunks_mut::<LANES>();
    let (likelihoods, likelihood_rest) = likelihood.as_chunks::<LANES>();
    let (priors, prior_rest) = prior.as_chunks::<LANES>();
    let (mut sum, mut other) = ([0.0; LANES], [0.0; LANES]);
    for ((row, likelihood), prior) in rows.iter().zip(likelihoods).zip(priors) {
        sum = std::array::from_fn(|i| sum[i] + row[i]);
        other = std::array::from_fn(|i| other[i] + likelihood[i] * prior[i]);
    }
    for (i, row) in row_rest.iter().enumerate() {
        sum[i] += row;
        other[i] += likelihood_rest[i] * prior_rest[i];
    }
    let [sum, other] = [sum, other].map(|lanes| lanes.iter().sum::<f64>());
    if other < f64::MIN_POSITIVE {
        return mix(row, &[1.0; _], prior, share);
    }
    let scale = (1.0 - share) * sum.max(f64::MIN_POSITIVE).recip();
    let by = share * other.recip();
    for ((row, likelihood), prior) in rows.iter_mut().zip(likelihoods).zip(priors) {
        *row = std::array::from_fn(|i| scale * row[i] + by * likelihood[i] * prior[i]);
    }
    for (i, row) in row_rest.iter_mut().enumerate() {
        *row = scale * *row + by * likelihood_rest[i] * prior_rest[i];
    }
}

/// Multiplies each value by that of another row.
pub(crate) fn multiply(row: &mut Row, by: &Row) {
    combine(row, by, |value, by| value * by);
}

/// The forward recursion from one cell to the next: divides by the sum, and mixes the prior in with the probability `change`
/// that the surface changes.
pub(crate) fn pass_forward(row: &mut Row, prior: &Row, change: f64) {
    let scale = one_over_sum(row);
    combine(row, prior, |value, prior| {
        let value = value * scale;
        value + change * (prior - value)
    });
}

/// The backward recursion from one cell to the one before it. The result is divided by its largest value, so that products
/// of many rows neither overflow nor vanish.
pub(crate) fn pass_backward(row: &mut Row, prior: &Row, change: f64) {
    let mut weighted = *row;
    multiply(&mut weighted, prior);
    let mean: f64 = weighted.iter().sum();
    let mut most = [f64::MIN_POSITIVE; LANES];
    let larger = |a: f64, b: f64| if b > a { b } else { a };
    let (lanes, rest) = row.as_chunks_mut::<LANES>();
    for lane in lanes {
        *lane = lane.map(|value| value + change * (mean - value));
        most = std::array::from_fn(|i| larger(most[i], lane[i]));
    }
    for (value, most) in rest.iter_mut().zip(&mut most) {
        *value += change * (mean - *value);
        *most = larger(*most, *value);
    }
    let scale = most.into_iter().fold(0.0, larger).recip();
    combine(row, prior, |value, _| value * scale);
}

/// Values that are computed together. The compiler uses vector instructions for such parts of a row, which it does not for
/// a loop over a whole one.
const LANES: usize = 8;

/// Replaces each value by that of `f` for it and the one of another row.
pub(crate) fn combine(row: &mut Row, other: &Row, f: impl Fn(f64, f64) -> f64) {
    let (lanes, rest) = row.as_chunks_mut::<LANES>();
    let (others, others_rest) = other.as_chunks::<LANES>();
    for (lane, other) in lanes.iter_mut().zip(others) {
        *lane = std::array::from_fn(|i| f(lane[i], other[i]));
    }
    for (value, other) in rest.iter_mut().zip(others_rest) {
        *value = f(*value, *other);
    }
}

fn one_over_sum(row: &Row) -> f64 {
    row.iter().sum::<f64>().max(f64::MIN_POSITIVE).recip()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row without order.
    fn row(seed: usize) -> Row {
        std::array::from_fn(|i| 0.1 + ((7 * i + seed) % 13) as f64)
    }

    #[test]
    fn masses_without_a_finite_sum_are_the_prior() {
        let grid = Grid::new();
        let (median, prior) = (grid.quantile(&grid.prior, 0.5), grid.prior);
        for nothing in [[0.0; LEVELS], [f64::NAN; LEVELS]] {
            assert_eq!(grid.quantile(&nothing, 0.5).to_bits(), median.to_bits());
            assert_eq!(
                grid.median_and_std(&nothing).map(f64::to_bits),
                grid.median_and_std(&prior).map(f64::to_bits)
            );
        }
    }

    #[test]
    fn mixtures_are_of_probabilities() {
        let prior = Grid::new().prior;
        let normalised = |mut row: Row| {
            to_probabilities(&mut row);
            row
        };
        for likelihood in [row(2), [0.0; _]] {
            let mut found = row(1).map(|value| 1e-3 * value);
            mix(&mut found, &likelihood, &prior, 0.3);
            let mut other = prior;
            if likelihood != [0.0; _] {
                multiply(&mut other, &likelihood);
            }
            let (own, other) = (normalised(row(1)), normalised(other));
            for i in 0..LEVELS {
                let expected = 0.7 * own[i] + 0.3 * other[i];
                assert!((found[i] / expected - 1.0).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn messages_are_those_of_the_transition_matrix() {
        let (prior, change) = (Grid::new().prior, 0.3);
        // From one coefficient to another in the next cell.
        let transition = |from: usize, to: usize| {
            change * prior[to] + if from == to { 1.0 - change } else { 0.0 }
        };
        let (before, mut forward) = (row(1), row(1));
        pass_forward(&mut forward, &prior, change);
        let (after, mut backward) = (row(2), row(2));
        pass_backward(&mut backward, &prior, change);
        let sum: f64 = before.iter().sum();
        let ahead = |h: usize| {
            (0..LEVELS)
                .map(|k| transition(h, k) * after[k])
                .sum::<f64>()
        };
        let most = (0..LEVELS).map(ahead).fold(0.0, f64::max);
        for h in 0..LEVELS {
            let behind: f64 = (0..LEVELS).map(|k| before[k] * transition(k, h)).sum();
            assert!((forward[h] - behind / sum).abs() < 1e-12, "{h}");
            assert!((backward[h] - ahead(h) / most).abs() < 1e-12, "{h}");
        }
    }
}
