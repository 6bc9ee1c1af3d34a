//! Blends of few members in place of blends of many.

/// Replaces `w` by the blend with the smallest cost `½ wᵀHw + gᵀw` plus `penalty` for each positive weight, of `w` itself, all
/// single members and all blends of two.
///
/// * `hessian`: `H`, row-major `[n, n]`, positive definite
/// * `linear`: `g`
/// * `w`: on the simplex; the minimiser of the cost, so that no other blend of as many members is better
pub(super) fn best_subset(hessian: &[f64], linear: &[f64], penalty: f64, w: &mut [f64]) {
    let n = w.len();
    let h = |i: usize, j: usize| hessian[i * n + j];
    let members = w.iter().filter(|w| **w > 0.0).count();
    let mut best = cost(hessian, linear, w) + penalty * members as f64;
    let mut blend = None;
    for i in 0..n {
        let single = h(i, i) / 2.0 + linear[i] + penalty;
        if single < best {
            (best, blend) = (single, Some((i, i, 1.0)));
        }
        for j in 0..i {
            let curvature = h(i, i) - 2.0 * h(i, j) + h(j, j);
            let share = (h(j, j) - h(i, j) + linear[j] - linear[i]) / curvature;
            if !(0.0..1.0).contains(&share) {
                continue; // the minimum is one of the two members alone
            }
            let of_j = h(j, j) / 2.0 + linear[j];
            let pair = of_j - curvature * share * share / 2.0 + 2.0 * penalty;
            if pair < best {
                (best, blend) = (pair, Some((i, j, share)));
            }
        }
    }
    if let Some((i, j, share)) = blend {
        w.fill(0.0);
        w[j] = 1.0 - share;
        w[i] = share;
    }
}

/// `½ wᵀHw + gᵀw`.
fn cost(hessian: &[f64], linear: &[f64], w: &[f64]) -> f64 {
    let rows = hessian.chunks_exact(w.len()).zip(linear).zip(w);
    rows.map(|((row, g), w_i)| {
        let product: f64 = row.iter().zip(w).map(|(h, w)| h * w).sum();
        w_i * (product / 2.0 + g)
    })
    .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `H = 2 I` and `g` of the cost `||w - target||²`.
    fn distance(target: [f64; 3]) -> ([f64; 9], [f64; 3]) {
        let mut hessian = [0.0; 9];
        for i in 0..3 {
            hessian[4 * i] = 2.0;
        }
        (hessian, target.map(|w| -2.0 * w))
    }

    #[test]
    fn a_member_with_little_effect_is_dropped_and_one_with_more_is_kept() {
        for (target, penalty, expected) in [
            ([0.02, 0.98, 0.0], 0.001, [0.0, 1.0, 0.0]),
            ([0.02, 0.98, 0.0], 0.0001, [0.02, 0.98, 0.0]),
            ([0.4, 0.58, 0.02], 0.001, [0.41, 0.59, 0.0]),
            ([0.3, 0.3, 0.4], 0.001, [0.3, 0.3, 0.4]),
        ] {
            let (hessian, linear) = distance(target);
            let mut w = target;
            best_subset(&hessian, &linear, penalty, &mut w);
            for (found, expected) in w.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-12, "{w:?}, {target:?}");
            }
        }
    }

    #[test]
    fn the_blend_of_two_is_the_best_of_a_fine_grid() {
        let (hessian, linear) = (
            [3.0, 1.0, 0.5, 1.0, 2.0, 0.3, 0.5, 0.3, 4.0],
            [-1.0, -0.4, -1.6],
        );
        let mut w = [0.3, 0.3, 0.4];
        best_subset(&hessian, &linear, 1.0, &mut w);
        let grid = (0..3).flat_map(|i| {
            (0..=1000).map(move |step| {
                let mut blend = [0.0; 3];
                blend[i] = f64::from(step) / 1000.0;
                blend[(i + 1) % 3] = 1.0 - blend[i];
                blend
            })
        });
        let of = |w: &[f64; 3]| {
            let members = w.iter().filter(|w| **w > 0.0).count();
            cost(&hessian, &linear, w) + members as f64
        };
        let best = grid.map(|blend| of(&blend)).fold(f64::INFINITY, f64::min);
        assert!(of(&w) <= best, "{w:?}");
    }
}
