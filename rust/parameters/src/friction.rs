//! The hypotheses about the friction coefficient of a road, and interpolation between them.

/// Smallest and largest friction coefficient of a road; before anything is known, all between are equally likely.
pub const FRICTION_RANGE: (f64, f64) = (0.1, 1.3);

/// Information about the friction in nats (divergence of the posterior from the prior) from which transitions are informed.
pub const FRICTION_INFORMED: f64 = 0.1;

/// Number of hypotheses about the friction coefficient.
pub const FRICTION_HYPOTHESES: usize = 17;

/// Friction coefficient of each hypothesis: equidistant in `ln mu` over [`FRICTION_RANGE`], increasing.
pub fn friction_hypotheses() -> [f64; FRICTION_HYPOTHESES] {
    let (low, high) = FRICTION_RANGE;
    let gap = (high / low).ln() / (FRICTION_HYPOTHESES - 1) as f64;
    std::array::from_fn(|i| low * (gap * i as f64).exp())
}

/// Interpolates values at the hypotheses in `ln mu`, by the cubic of Catmull and Rom through four of them; beyond the
/// ends they are continued linearly. Used for logarithms of likelihoods, which are nearly parabolas.
///
/// `position` counts hypotheses from the first and is at most that of the last.
pub fn interpolate_hypotheses(values: &[f64; FRICTION_HYPOTHESES], position: f64) -> f64 {
    const LAST: usize = FRICTION_HYPOTHESES - 1;
    // The position is small and not negative.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let i = (position as usize).min(LAST - 1);
    let t = position - i as f64;
    let (b, c) = (values[i], values[i + 1]);
    let a = if i > 0 { values[i - 1] } else { 2.0 * b - c };
    let d = if i + 2 <= LAST {
        values[i + 2]
    } else {
        2.0 * c - b
    };
    let cubic = 3.0 * (b - c) + d - a;
    let square = 2.0 * a - 5.0 * b + 4.0 * c - d;
    b + 0.5 * t * (c - a + t * (square + t * cubic))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hypotheses_span_the_range_and_are_interpolated() {
        let mu = friction_hypotheses();
        assert_eq!(
            (mu[0], mu[FRICTION_HYPOTHESES - 1].to_bits()),
            (0.1, 1.3_f64.to_bits())
        );
        assert!(mu.windows(2).all(|pair| pair[0] < pair[1]));
        let parabola = |x: f64| 3.0 - 2.0 * x + 0.5 * x * x;
        let values = std::array::from_fn(|i| parabola(i as f64));
        for position in [1.0, 1.25, 7.5, 14.75] {
            let value = interpolate_hypotheses(&values, position);
            assert!((value - parabola(position)).abs() < 1e-12, "{position}");
        }
        for i in 0..FRICTION_HYPOTHESES {
            assert_eq!(interpolate_hypotheses(&values, i as f64), values[i]);
        }
    }
}
