//! Closed tracks of straights and right-angled corners.

use std::f64::consts::FRAC_PI_2;

use super::corner::Corner;
use super::{SPACING, check_length};
use crate::error::PathError;
use crate::path::Path;

/// A rectangle driven counter-clockwise from the middle of its lower side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoundedRectangle {
    /// Side along x in m, between the outermost points of the reference line.
    pub length: f64,
    /// Side along y in m.
    pub width: f64,
    /// Shape of the corners.
    pub corner: Corner,
    /// Width of the track in m.
    pub track_width: f64,
}

/// An L, driven counter-clockwise from the middle of its lower side, with five left turns and one right turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LShape {
    /// Lower side along x in m.
    pub length: f64,
    /// Left side along y in m.
    pub width: f64,
    /// Width of both arms of the L in m.
    pub arm: f64,
    /// Shape of the corners.
    pub corner: Corner,
    /// Width of the track in m.
    pub track_width: f64,
}

impl Default for RoundedRectangle {
    /// Dimensions for a lap of half a minute on mixed surfaces.
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
    /// [`PathError`] if a dimension is not positive or a side is too short for its corners.
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
    /// [`PathError`] if a dimension is not positive or a side is too short for its corners.
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

/// The outline with the given sides, each ending in a left (1) or right (-1) turn, from the middle of
/// the first side.
fn outline(sides: &[(f64, f64)], corner: Corner, track_width: f64) -> Result<Path, PathError> {
    corner.check()?;
    check_length("track_width", track_width)?;
    let turn = corner.sample();
    let reach = turn.last().map_or(0.0, |end| end[0]);
    let straights = (sides.iter())
        .map(|&(side, _)| {
            check_length("each side", side)?;
            let straight = side - 2.0 * reach;
            if straight < SPACING {
                return Err(PathError::Track(format!(
                    "a side of {side} m is too short for its two corners of {reach:.1} m; \
                     lengthen the side, or shorten the radius or the transition"
                )));
            }
            Ok(straight)
        })
        .collect::<Result<Vec<_>, _>>()?;

    let mut pen = Pen::default();
    pen.straight(straights[0] / 2.0);
    for (i, &(_, left)) in sides.iter().enumerate() {
        pen.turn(&turn, left);
        pen.straight(straights.get(i + 1).copied().unwrap_or(straights[0] / 2.0));
    }
    pen.points.rotate_right(1); // the last point is the origin, where the lap starts
    let widths = vec![[track_width / 2.0; 2]; pen.points.len()];
    Path::from_points(&pen.points, true, Some(&widths))
}

/// Appends waypoints, from the origin in the direction +x.
#[derive(Default)]
struct Pen {
    points: Vec<[f64; 2]>,
    at: [f64; 2],
    quarter_turns: f64,
}

impl Pen {
    fn straight(&mut self, length: f64) {
        let count = (length / SPACING).ceil() as usize;
        self.draw((1..=count).map(|i| [length * i as f64 / count as f64, 0.0]));
    }

    fn turn(&mut self, corner: &[[f64; 2]], left: f64) {
        self.draw(corner.iter().map(|&[u, v]| [u, left * v]));
        self.quarter_turns += left;
    }

    /// Appends points given relative to the pen's position and heading.
    fn draw(&mut self, points: impl Iterator<Item = [f64; 2]>) {
        let [x, y] = self.at;
        let (sin, cos) = (self.quarter_turns * FRAC_PI_2).sin_cos();
        for [u, v] in points {
            self.at = [x + u * cos - v * sin, y + u * sin + v * cos];
            self.points.push(self.at);
        }
    }
}
