//! Reference paths: geometry, speed and what the controller is asked to follow.
//!
//! A [`Path`] is a curve parametrised by its arc length `s`, with distances to the track's edges and
//! zones of friction. A [`SpeedProfile`] says how fast each point of it can be driven, and
//! [`horizon_reference`] samples both by time from where the vehicle is. [`tracks`] computes the
//! built-in ones from their definition, [`formats`] reads those of other projects.
//!
//! SI units and radians; yaw counter-clockwise from +x, lateral errors positive to the left. On an
//! open path `s` may lie before the start or past the end: the path goes on straight there.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // counts and knots: small, positive

mod arc_length;
mod error;
pub mod formats;
mod friction;
mod horizon;
mod limits;
mod path;
mod projection;
mod speed;
mod spline;
pub mod tracks;

pub use error::PathError;
pub use friction::Zone;
pub use horizon::horizon_reference;
pub use limits::SpeedLimits;
pub use path::{Path, Sample};
pub use projection::Projection;
pub use speed::SpeedProfile;
