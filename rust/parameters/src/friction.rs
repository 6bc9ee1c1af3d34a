//! The hypotheses about the friction coefficient of a road, and interpolation between them.

/// Smallest and largest friction coefficient of a road; before anything is known, all between are equally likely.
pub const FRICTION_RANGE: (f64, f64) = (0.1, 1.3);

/// Information about the friction in nats (divergence of the posterior from the prior) from which transitions are informed.
pub const FRICTION_INFORMED: f64 = 0.1;

/// Number of hypotheses about the friction coefficient.
pub const FRICTION_HYPOTHESES: usize = 17;

/// Smallest logarithm of the likelihood of a hypothesis, relative to the largest, in replies and as evidence of a belief.
/// Without this limit the logarithms would go to minus infinity as the noise goes to zero.
pub const LEAST_LOG_LIKELIHOOD: f64 = -1e6;

/// Friction coefficient of each hypothesis: equidistant in `ln mu` over [`FRICTION_RANGE`], increasing.
pub fn friction_hypotheses() -> [f64; FRICTION_HYPOTHESES] {
    let (low, high) = FRICTION_RANGE;
    let gap = (high / low).ln() / (FRICTION_HYPOTHESES - 1) as f64;
    std::array::from_fn(|i| low * (gap * i as f64).exp())
}

/// Ratio of second differences up to which both come from one smooth curve; those of a parabola are equal.
const SMOOTH: f64 = 4.0;

/// Interpolates values at the hypotheses in `ln mu`. Used for logarithms of likelihoods.
///
/// With the second differences `D` at the neighbours `b` and `c`, this is the cubic of Catmull and Rom,
///
/// ```text
/// (1 - t) b + t c - t (1 - t) ((1 - t) D_b + t D_c) / 2
/// ```
///
/// which reproduces parabolas exactly. Second differences at both ends are zero, so that the first and the last interval are
/// linear. A likelihood that falls steeply beside a flat part, where one surface cannot transmit a force that all others can,
/// is no parabola, and the cubic would rise above the flat part by 7 % of the fall. The larger second difference therefore
/// counts as at most four times the smaller one, and both as zero if their signs differ (the limiter of Harten and Osher,
/// *Uniformly High-Order Accurate Nonoscillatory Schemes*, SIAM Journal on Numerical Analysis 24(2), 1987).
///
/// `position` counts hypotheses from the first, 0, and must lie in `[0, FRICTION_HYPOTHESES - 1]`.
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
    let (at_b, at_c) = limited(a - 2.0 * b + c, b - 2.0 * c + d);
    (1.0 - t) * b + t * c - 0.5 * t * (1.0 - t) * ((1.0 - t) * at_b + t * at_c)
}

/// Two neighbouring second differences, of which neither is more than [`SMOOTH`] times the other; zero if their signs differ.
fn limited(left: f64, right: f64) -> (f64, f64) {
    if left * right <= 0.0 {
        return (0.0, 0.0);
    }
    let most = SMOOTH * left.abs().min(right.abs());
    (left.clamp(-most, most), right.clamp(-most, most))
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

    #[test]
    fn beside_a_cliff_the_flat_part_stays_flat() {
        for fall in [1.0, 60.0, 1e6] {
            let cliff = std::array::from_fn(|i| if i < 6 { -fall } else { 0.0 });
            let tilted =
                std::array::from_fn(|i| cliff[i] - if i > 6 { 0.01 * i as f64 } else { 0.0 });
            for k in 0..=160 {
                let position = 0.1 * f64::from(k);
                let value = interpolate_hypotheses(&cliff, position);
                assert!((-fall..=0.0).contains(&value), "{position}: {value}");
                let value = interpolate_hypotheses(&tilted, position);
                assert!((-fall..=0.01).contains(&value), "{position}: {value}");
            }
        }
    }
}
