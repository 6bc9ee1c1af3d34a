//! Right-angled corners with continuous curvature.

use std::f64::consts::FRAC_PI_2;

use egp_parameters::OutOfRange;

use super::{SPACING, check_length};
use crate::error::check;

/// A turn by 90°: clothoid, arc, clothoid, so that curvature is continuous.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    /// Radius of the arc in m.
    pub radius: f64,
    /// Length of each clothoid in m, below `radius * pi / 2`.
    pub transition: f64,
}

impl Default for Corner {
    fn default() -> Self {
        Self {
            radius: 15.0,
            transition: 10.0,
        }
    }
}

impl Corner {
    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        check_length("radius", self.radius)?;
        check(
            "transition",
            self.transition,
            "a length in (0, radius * pi / 2)",
            |t| t > 0.0 && t < self.radius * FRAC_PI_2,
        )
    }

    /// Arc length: each clothoid turns by `transition / (2 radius)`.
    fn length(&self) -> f64 {
        self.radius * FRAC_PI_2 + self.transition
    }

    /// Yaw after arc length `s`: the integral of a curvature that rises linearly, is constant, and falls linearly.
    fn yaw(&self, s: f64) -> f64 {
        let rising = |s: f64| s * s / (2.0 * self.radius * self.transition);
        let end = self.length() - self.transition;
        if s <= self.transition {
            rising(s)
        } else if s <= end {
            (s - self.transition / 2.0) / self.radius
        } else {
            FRAC_PI_2 - rising(self.length() - s)
        }
    }

    /// Points along a left turn from the origin (excluded) in the direction +x, by Simpson's rule on the yaw. The
    /// corner is symmetric, so it has the same extent along both sides.
    pub(super) fn sample(&self) -> Vec<[f64; 2]> {
        const PARTS: u32 = 8;
        let count = (self.length() / SPACING).ceil().max(8.0) as usize;
        let step = self.length() / count as f64;
        let part = step / f64::from(PARTS);
        let mut at = [0.0; 2];
        (0..count)
            .map(|i| {
                for k in 0..PARTS {
                    let s = i as f64 * step + f64::from(k) * part;
                    let [a, m, b] = [s, s + part / 2.0, s + part].map(|s| self.yaw(s).sin_cos());
                    at[0] += part / 6.0 * (a.1 + 4.0 * m.1 + b.1);
                    at[1] += part / 6.0 * (a.0 + 4.0 * m.0 + b.0);
                }
                at
            })
            .collect()
    }
}
