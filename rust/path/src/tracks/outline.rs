//! Closed tracks of straights and right-angled corners.

use std::f64::consts::FRAC_PI_2;

use super::{SPACING, check_length};
use crate::error::{PathError, check};
use crate::path::Path;

/// A rectangle driven counter-clockwise from the middle of its lower side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoundedRectangle {
    /// Side along x in m, between the outermost points of the reference line.
    pub length: f64,
    /// Side along y in m.
    pub width: f64,
    /// How corners are driven.
    pub corner: Corner,
    /// Width of the track in m.
    pub track_width: f64,
}

/// An L, driven counter-clockwise from the middle of its lower side; five left turns and a right one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LShape {
    /// Lower side along x in m.
    pub length: f64,
    /// Left side along y in m.
    pub width: f64,
    /// Width of both arms of the L in m.
    pub arm: f64,
    /// How corners are driven.
    pub corner: Corner,
    /// Width of the track in m.
    pub track_width: f64,
}

/// A turn by 90°: a clothoid in, an arc, a clothoid out, so that curvature is continuous.
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

impl Default for RoundedRectangle {
    /// A lap of half a minute on mixed surfaces.
    fn default() -> Self {
        Self {
            length: 120.0,
            width: 60.0,
            corner: Corner::default(),
            track_width: 7.0,
        }
    }
}

impl Default for LShape {
    fn default() -> Self {
        Self {
            length: 130.0,
            width: 110.0,
            arm: 50.0,
            corner: Corner::default(),
            track_width: 7.0,
        }
    }
}

impl RoundedRectangle {
    /// The path.
    ///
    /// # Errors
    /// Dimensions that aren't positive, or sides too short for their corners.
    pub fn path(&self) -> Result<Path, PathError> {
        let Self { length, width, .. } = *self;
        outline(
            &[(length, 1.0), (width, 1.0), (length, 1.0), (width, 1.0)],
            self.corner,
            self.track_width,
        )
    }
}

impl LShape {
    /// The path.
    ///
    /// # Errors
    /// Dimensions that aren't positive, or sides too short for their corners.
    pub fn path(&self) -> Result<Path, PathError> {
        let Self {
            length, width, arm, ..
        } = *self;
        let sides = [
            (length, 1.0),
            (arm, 1.0),
            (length - arm, -1.0),
            (width - arm, 1.0),
            (arm, 1.0),
            (width, 1.0),
        ];
        outline(&sides, self.corner, self.track_width)
    }
}

/// Samples the outline with the given sides, each ending in a left (1) or right (-1) turn, from the
/// middle of the first side.
fn outline(sides: &[(f64, f64)], corner: Corner, track_width: f64) -> Result<Path, PathError> {
    corner.check()?;
    check_length("track_width", track_width)?;
    sides
        .iter()
        .try_for_each(|&(side, _)| check_length("each side", side))?;
    let turn = corner.sample();
    let reach = corner.reach();
    let mut points = vec![[0.0, 0.0]];
    let (mut x, mut y, mut quarter_turns) = (0.0, 0.0, 0.0);
    let straight = |x: &mut f64, y: &mut f64, yaw: f64, length: f64, points: &mut Vec<[f64; 2]>| {
        let count = (length / SPACING).ceil().max(1.0);
        for _ in 0..count as usize {
            *x += length / count * yaw.cos();
            *y += length / count * yaw.sin();
            points.push([*x, *y]);
        }
    };
    for (i, &(side, left)) in sides.iter().enumerate() {
        let yaw: f64 = quarter_turns * FRAC_PI_2;
        let length = side - 2.0 * reach;
        if length.is_nan() || length < SPACING {
            return Err(PathError::Track(format!(
                "a side of {side} m is too short for its two corners of {reach:.1} m; \
                 make it longer, or the radius or the transition shorter"
            )));
        }
        straight(
            &mut x,
            &mut y,
            yaw,
            if i == 0 { length / 2.0 } else { length },
            &mut points,
        );
        let (sin, cos) = yaw.sin_cos();
        points.extend(
            turn.iter()
                .map(|&[u, v]| [x + u * cos - v * left * sin, y + u * sin + v * left * cos]),
        );
        if let Some(&[a, b]) = points.last() {
            (x, y) = (a, b);
        }
        quarter_turns += left;
    }
    let half = (sides[0].0 - 2.0 * reach) / 2.0;
    straight(&mut x, &mut y, quarter_turns * FRAC_PI_2, half, &mut points);
    points.pop();
    let widths = vec![[track_width / 2.0; 2]; points.len()];
    Path::from_points(&points, true, Some(&widths))
}

impl Corner {
    fn check(&self) -> Result<(), PathError> {
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

    /// Yaw after arc length `s`: the integral of a curvature that rises, stays and falls.
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

    /// Distance from where the corner starts to where the two sides would meet. The corner is
    /// symmetric, so it is its extent along either side.
    fn reach(&self) -> f64 {
        self.sample().last().map_or(0.0, |end| end[0])
    }

    /// Points along a left turn that starts at the origin along +x, by Simpson's rule on the yaw.
    fn sample(&self) -> Vec<[f64; 2]> {
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
