//! A straight road with repeated lane changes.

use super::{SPACING, check_length};
use crate::error::PathError;
use crate::path::Path;

/// Lane changes to the left and back along +x with straights between them, as many as the length allows. The lateral
/// position in a transition is the fifth-order polynomial with zero slope and curvature at both ends,
/// `offset (10 u³ - 15 u⁴ + 6 u⁵)`, whose curvature is at most `5.8 offset / transition²`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaneChanges {
    /// Length of the road in m.
    pub length: f64,
    /// Distance between the lanes in m.
    pub offset: f64,
    /// Length along the road of one lane change in m.
    pub transition: f64,
    /// Length of the straight before each change in m.
    pub hold: f64,
    /// Width of the track about the path in m.
    pub track_width: f64,
}

impl Default for LaneChanges {
    /// Dimensions that need a lateral acceleration of 3.6 m/s² at 15 m/s.
    fn default() -> Self {
        Self {
            length: 500.0,
            offset: 2.5,
            transition: 30.0,
            hold: 20.0,
            track_width: 7.0,
        }
    }
}

impl LaneChanges {
    /// The path.
    ///
    /// # Errors
    /// [`PathError`] if a dimension is not positive or the road is too short for a lane change and back.
    pub fn path(&self) -> Result<Path, PathError> {
        for (name, value) in [
            ("length", self.length),
            ("offset", self.offset),
            ("transition", self.transition),
            ("hold", self.hold),
            ("track_width", self.track_width),
        ] {
            check_length(name, value)?;
        }
        let period = self.hold + self.transition;
        let pairs = ((self.length - self.hold) / (2.0 * period)).floor();
        if pairs < 1.0 {
            return Err(PathError::Track(format!(
                "a road of {} m is too short for a lane change and back, which takes {} m",
                self.length,
                2.0 * period + self.hold
            )));
        }
        let count = (self.length / SPACING).ceil() as usize;
        let points: Vec<_> = (0..=count)
            .map(|i| self.length * i as f64 / count as f64)
            .map(|x| [x, self.lateral(x.min(2.0 * pairs * period))])
            .collect();
        let widths = vec![[self.track_width / 2.0; 2]; points.len()];
        Path::from_points(&points, false, Some(&widths))
    }

    fn lateral(&self, x: f64) -> f64 {
        let period = self.hold + self.transition;
        let changes = (x / period).floor();
        let u = ((x - changes * period - self.hold) / self.transition).max(0.0);
        let step = u * u * u * (10.0 + u * (6.0 * u - 15.0));
        if changes % 2.0 == 0.0 {
            self.offset * step
        } else {
            self.offset * (1.0 - step)
        }
    }
}
