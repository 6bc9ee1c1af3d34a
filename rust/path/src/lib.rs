//! Reference paths: geometry, speed profile and the controller's reference over its horizon.
//!
//! A [`Path`] is a curve parametrised by its arc length `s`, with distances to the track's edges and zones of friction.
//! A [`SpeedProfile`] gives the speed at each point of the path, a [`SpeedPlanner`] that of the next 250 m for estimated
//! friction, and [`horizon_reference`] samples path and profile by time from the vehicle's position. [`tracks`] computes the
//! built-in tracks from their definitions, and [`formats`] reads the track files of other projects.
//!
//! SI units and radians; yaw counter-clockwise from +x, lateral errors positive to the left. On an
//! open path `s` may lie before the start or past the end, where the path continues straight.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // counts and knot indices are small and positive

mod arc_length;
mod error;
pub mod formats;
mod friction;
mod horizon;
mod knot;
mod limits;
mod parts;
mod path;
mod planner;
mod projection;
mod speed;
mod spline;
pub mod tracks;

pub use error::PathError;
pub use friction::Zone;
pub use horizon::{HorizonRows, ReferenceStart, horizon_reference};
pub use limits::SpeedLimits;
pub use parts::PathParts;
pub use path::{Path, Sample};
pub use planner::SpeedPlanner;
pub use projection::Projection;
pub use speed::SpeedProfile;
