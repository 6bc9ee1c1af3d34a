//! What the controller is asked to follow over its horizon.

use std::f64::consts::TAU;

use crate::error::{PathError, check};
use crate::path::Path;
use crate::projection::Projection;
use crate::speed::SpeedProfile;

/// Writes the reference `[p_x, p_y, v_x, psi]` and the widths `[left, right]` of the stages `0..=T`,
/// one row each, and returns the vehicle's projection.
///
/// Stage `k` is where the profile has carried the vehicle's projection after `k dt` seconds:
/// `ds/dt = v(s)`, so braking and cornering stand in the reference instead of being fought. Yaw is
/// unwrapped: the first row lies within pi of `psi`, and each next one within pi of the row before.
/// `hint` is the last projection's `s`. Past an open path's end the reference goes straight on.
/// Allocates nothing.
///
/// # Errors
/// A position, yaw or hint that isn't finite, a period that isn't positive, a profile of another path, or
/// slices of different length.
#[allow(clippy::too_many_arguments)] // each is a quantity of its own
pub fn horizon_reference(
    path: &Path,
    profile: &SpeedProfile,
    position: [f64; 2],
    psi: f64,
    dt: f64,
    hint: Option<f64>,
    reference: &mut [[f64; 4]],
    widths: &mut [[f64; 2]],
) -> Result<Projection, PathError> {
    for (name, value) in [("p_x", position[0]), ("p_y", position[1]), ("psi", psi)] {
        check(name, value, "a finite number", |_| true)?;
    }
    check(
        "hint",
        hint.unwrap_or_default(),
        "a finite arc length",
        |_| true,
    )?;
    check("dt", dt, "a positive number of seconds", |dt| dt > 0.0)?;
    if profile.length() != path.length() {
        return Err(PathError::ForeignProfile {
            profile: profile.length(),
            path: path.length(),
        });
    }
    if reference.is_empty() || reference.len() != widths.len() {
        return Err(PathError::HorizonRows {
            reference: reference.len(),
            widths: widths.len(),
        });
    }
    let projection = path.project(position, hint);
    let now = profile.time(projection.s);
    let mut yaw = psi;
    for (stage, (row, edges)) in reference.iter_mut().zip(widths).enumerate() {
        // A profile that stands still at a path's end has no time there: the reference stays.
        let s = if now.is_finite() {
            profile.station(now + stage as f64 * dt)
        } else {
            projection.s
        };
        let sample = path.sample(s);
        yaw += (sample.yaw - yaw) - TAU * ((sample.yaw - yaw) / TAU).round();
        *row = [sample.x, sample.y, profile.speed(s), yaw];
        *edges = [sample.left, sample.right];
    }
    Ok(projection)
}
