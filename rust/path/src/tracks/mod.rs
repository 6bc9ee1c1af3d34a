//! Built-in tracks, computed from their definitions. All start at the origin in the direction +x.

mod corner;
mod double_lane_change;
mod lane_changes;
mod outline;
mod random;

pub use corner::Corner;
pub use double_lane_change::{DoubleLaneChange, Section};
pub use lane_changes::LaneChanges;
pub use outline::{LShape, RoundedRectangle};
pub use random::RandomTrack;

use egp_parameters::OutOfRange;

use crate::error::check;

/// Distance between waypoints in m.
const SPACING: f64 = 0.5;

/// Errors if a length is not positive or would need too many waypoints.
fn check_length(name: &'static str, value: f64) -> Result<(), OutOfRange> {
    check(name, value, "a length in (0, 50000] m", |x| {
        x > 0.0 && x <= 50_000.0
    })
}
