//! The default of the horizon.

use super::periods;
use crate::vehicle::SLIPPERY;

/// The default horizon in s of a full-size vehicle if no member is slippery, and in periods at most.
const HORIZON: f64 = 0.8;
const LONGEST: usize = 120;

/// The default of [`Settings::horizon`](super::Settings::horizon()) for a period of `dt` s, the coefficient `friction` of the
/// most slippery member, and a vehicle of this scale.
pub(super) fn default_horizon(dt: f64, friction: f64, scale: f64) -> usize {
    let slippery = (SLIPPERY / friction).max(1.0).powf(2.0 / 3.0);
    periods(HORIZON * scale.sqrt() * slippery, dt, LONGEST)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_horizon_is_longer_if_a_member_is_slippery() {
        let horizon = |friction| default_horizon(0.02, friction, 1.0);
        let frictions = [1.1, 0.5, 0.3, 0.1, 0.01];
        assert_eq!(frictions.map(horizon), [40, 40, 56, 117, 120]);
    }

    #[test]
    fn the_horizon_of_small_vehicles_is_shorter() {
        let horizon = |scale| default_horizon(0.02, 1.0, scale);
        assert_eq!([1.0, 0.25, 0.16, 1e-6].map(horizon), [40, 20, 16, 1]);
    }
}
