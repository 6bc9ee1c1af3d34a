//! The course of a simulated vehicle.

use std::str::FromStr;

use egp_path::tracks::{LShape, RoundedRectangle};
use egp_path::{Path, PathError, SpeedLimits, SpeedProfile, Zone};
use thiserror::Error;

use crate::vehicle::CAR;

/// A built-in closed track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Track {
    /// [`RoundedRectangle`].
    Rectangle,
    /// [`LShape`].
    LShape,
}

impl FromStr for Track {
    type Err = CourseError;

    fn from_str(text: &str) -> Result<Self, CourseError> {
        match text {
            "rectangle" => Ok(Self::Rectangle),
            "l-shape" => Ok(Self::LShape),
            _ => Err(CourseError::Track(text.to_owned())),
        }
    }
}

/// Why a course cannot be made.
#[derive(Debug, Error)]
pub enum CourseError {
    /// No built-in track of this name.
    #[error("no track {0:?}; there are rectangle and l-shape")]
    Track(String),
    /// Path, zones or speed are not valid.
    #[error(transparent)]
    Path(#[from] PathError),
}

/// A closed path with friction zones and the speed to drive it at.
#[derive(Clone, Debug)]
pub struct Course {
    /// Geometry, widths and zones.
    pub path: Path,
    /// Speed along it.
    pub profile: SpeedProfile,
}

impl Course {
    /// A track with its length divided evenly among `frictions`, driven at a fraction `grip` of the friction.
    ///
    /// # Errors
    /// [`CourseError::Path`] for friction or grip out of range.
    pub fn new(track: Track, frictions: &[f64], grip: f64) -> Result<Self, CourseError> {
        let path = match track {
            Track::Rectangle => RoundedRectangle::default().path()?,
            Track::LShape => LShape::default().path()?,
        };
        let zone = |(i, &friction)| Zone::new(i as f64 / frictions.len() as f64, friction);
        let zones: Vec<Zone> = frictions.iter().enumerate().map(zone).collect();
        let path = path.with_friction(&zones)?;
        let profile = SpeedProfile::new(
            &path,
            &SpeedLimits {
                grip,
                ..SpeedLimits::of(&CAR.vehicle())
            },
        )?;
        Ok(Self { path, profile })
    }
}
