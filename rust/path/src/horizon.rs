//! The controller's reference over its horizon.

use std::f64::consts::TAU;

use crate::error::{PathError, check};
use crate::path::Path;
use crate::projection::Projection;
use crate::speed::SpeedProfile;

/// Writes the reference `[p_x, p_y, v_x, psi]` and the widths `[left, right]` of the stages `0..=T`,
/// one row each, and returns the vehicle's projection.
///
/// Stage `k` is the point that the profile reaches from the vehicle's projection after `k dt` seconds, `ds/dt = v(s)`,
/// so the reference contains the braking and cornering of the profile. Yaw is unwrapped: the first row is within pi of
/// `psi`, and each other row within pi of the previous one. `hint` is the `s` of the last projection. Past the end of
/// an open path the reference continues straight. The rows do not depend on the vehicle's speed. If it may be far
/// below the profile's, as at a start, call [`catch_up`] afterwards. Allocates nothing.
///
/// # Errors
/// [`PathError`] if the position, yaw or hint is not finite, the period is not positive, the profile belongs to another
/// path, or the slices differ in length.
#[allow(clippy::too_many_arguments)] // the arguments are unrelated
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
    if profile.path_length() != path.length() {
        return Err(PathError::ForeignProfile {
            profile: profile.path_length(),
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
    // If the profile starts at speed zero, points before its start have the time minus infinity; the reference then begins at
    // the start.
    let from = profile.unwrapped(projection.s);
    let now = match profile.time(from) {
        f64::NEG_INFINITY => 0.0,
        time => time,
    };
    let mut yaw = psi;
    for (stage, (row, edges)) in reference.iter_mut().zip(widths).enumerate() {
        // A profile that stops at the path's end reaches it after infinite time; the reference then stays there.
        let s = if now.is_finite() {
            profile.station(now + stage as f64 * dt)
        } else {
            from
        };
        let sample = path.sample(s);
        yaw += (sample.yaw - yaw) - TAU * ((sample.yaw - yaw) / TAU).round();
        *row = [sample.x, sample.y, profile.speed(s), yaw];
        *edges = [sample.left, sample.right];
    }
    Ok(projection)
}

/// Difference in m/s up to which the reference speed may exceed the vehicle's without being changed.
const LAG: f64 = 2.0;

/// Acceleration of the limited reference, m/s²; cars reach it on snow.
const PICK_UP: f64 = 1.0;

/// Replaces the rows of [`horizon_reference`] if its first speed is more than 2 m/s above the vehicle's `v_x`, as at a start:
/// the speed is then at most `v_x + 2 m/s + 1 m/s² t` after `t` seconds, and the positions are those that it leads to.
/// Without this limit the reference positions would be far ahead of the vehicle, and the cost of the speed error would exceed
/// that of the position error.
///
/// `from` is the arc length of the vehicle's projection in m, and `dt` the period in s. Allocates nothing.
pub fn catch_up(
    path: &Path,
    profile: &SpeedProfile,
    from: f64,
    v_x: f64,
    dt: f64,
    reference: &mut [[f64; 4]],
    widths: &mut [[f64; 2]],
) {
    let Some([_, _, first, mut yaw]) = reference.first().copied() else {
        return;
    };
    if first <= v_x + LAG {
        return;
    }
    let mut s = profile.unwrapped(from);
    for (stage, (row, edges)) in reference.iter_mut().zip(widths).enumerate() {
        let most = v_x.max(0.0) + LAG + PICK_UP * stage as f64 * dt;
        let (sample, v) = (path.sample(s), profile.speed(s).min(most));
        yaw += (sample.yaw - yaw) - TAU * ((sample.yaw - yaw) / TAU).round();
        *row = [sample.x, sample.y, v, yaw];
        *edges = [sample.left, sample.right];
        s += v * dt;
    }
}
