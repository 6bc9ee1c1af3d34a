//! From an iterate of the interior point to a start of the active set.

use super::active_set::ActiveSet;
use super::band::Pressing;
use super::interior_point::Point;
use super::stage::{PAIRS, Stage};

/// A row presses if its multiplier is larger than its slack, and yields if its price does not keep the slack down.
#[inline(always)]
pub(super) fn hand_over(stages: &[Stage], points: &[Point], end: &mut ActiveSet) {
    for (t, (stage, point)) in stages.iter().zip(points).enumerate() {
        let rows = &point.rows;
        let mut pressing = Pressing::default();
        let mut lambda = [0.0; PAIRS];
        for k in 0..PAIRS {
            for (side, sign) in [(k, 1.0), (PAIRS + k, -1.0)] {
                if rows.lambda[side] > rows.slack[side] {
                    pressing.side[k] = sign;
                    pressing.yielding[k] =
                        rows.epsilon[side] > rows.gamma[side] && stage.band.limit[k].is_finite();
                    lambda[k] = sign * rows.lambda[side];
                }
            }
        }
        end.start_stage(t, &stage.band, (point.v, point.s), lambda, &pressing);
    }
}
