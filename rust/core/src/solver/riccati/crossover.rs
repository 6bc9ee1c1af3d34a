//! Crossover: from an iterate of the interior-point method to a start of the active-set method.

use super::active_set::ActiveSet;
use super::interior_point::Point;
use super::stage::{PAIRS, Stage};
use super::two_sided::WorkingSet;

/// Starts the active-set method. A row is taken as active if its multiplier exceeds its slack, and an active soft row
/// as violated if its violation `ε` exceeds the multiplier `γ` of `ε >= 0`.
#[inline(always)]
pub(super) fn crossover(stages: &[Stage], points: &[Point], active_set: &mut ActiveSet) {
    for (t, (stage, point)) in stages.iter().zip(points).enumerate() {
        let rows = &point.rows;
        let mut set = WorkingSet::default();
        let mut lambda = [0.0; PAIRS];
        for k in 0..PAIRS {
            for (side, sign) in [(k, 1.0), (PAIRS + k, -1.0)] {
                if rows.lambda[side] > rows.slack[side] {
                    set.side[k] = sign;
                    set.violated[k] =
                        rows.epsilon[side] > rows.gamma[side] && stage.rows.linear[k].is_finite();
                    lambda[k] = sign * rows.lambda[side];
                }
            }
        }
        active_set.start_stage(t, &stage.rows, (point.v, point.s), lambda, &set);
    }
}
