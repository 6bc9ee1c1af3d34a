//! The numbers that a path consists of.

use crate::error::{PathError, check};
use crate::friction::{Zone, check_zones};
use crate::path::check_finite;

/// The numbers that a path consists of, by which it is handed to another process: [`crate::Path::from_parts`] makes the same
/// path of those of [`crate::Path::parts`], bit for bit.
#[derive(Debug, Clone, PartialEq)]
pub struct PathParts {
    /// Whether the end joins the start.
    pub closed: bool,
    /// Distance between neighbouring knots, m.
    pub step: f64,
    /// For each stretch between neighbouring knots, `x` and `y` in m as cubics in the distance in m from its first knot,
    /// constant term first.
    pub pieces: Vec<[[f64; 4]; 2]>,
    /// Distances `[left, right]` in m to the track's edges at each knot, if they are known. An open path has a knot more than
    /// pieces.
    pub widths: Option<Vec<[f64; 2]>>,
    /// Zones of friction; may be empty.
    pub zones: Vec<Zone>,
}

impl PathParts {
    /// Errors unless a path can be made of the numbers.
    pub(crate) fn check(&self) -> Result<(), PathError> {
        let count = self.pieces.len();
        check("step", self.step, "1e-4 to 1e4 m", |step| {
            (1e-4..=1e4).contains(&step)
        })?;
        check(
            "the number of pieces",
            count as f64,
            "at least 1",
            |count| count >= 1.0,
        )?;
        check_finite("coefficients", self.pieces.as_flattened(), |_| true)?;
        if let Some(widths) = &self.widths {
            check_finite("widths of at least 0", widths, |w| w >= 0.0)?;
            let expected = count + usize::from(!self.closed);
            if widths.len() != expected {
                let got = widths.len();
                return Err(PathError::WidthCount { expected, got });
            }
        }
        check_zones(&self.zones)
    }
}
