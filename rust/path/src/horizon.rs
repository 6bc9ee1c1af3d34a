//! The controller's reference over its horizon.

use crate::error::{PathError, check};
use crate::path::{Path, wrap_angle};
use crate::projection::Projection;
use crate::speed::SpeedProfile;

/// The vehicle at the start of its reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceStart {
    /// Position `[p_x, p_y]` in m.
    pub position: [f64; 2],
    /// Yaw in rad.
    pub psi: f64,
    /// Longitudinal speed in m/s, if the reference shall begin near it where it is far below the profile's, as at a start. A
    /// speed that is not a number counts as 0. If it is not given, the reference does not depend on the vehicle's speed.
    pub catch_up_from: Option<f64>,
    /// Arc length in m near which the vehicle is looked for, such as the `s` of its last projection; without it the vehicle is
    /// looked for on the whole path.
    pub hint: Option<f64>,
}

/// The reference and the distances to the edges at the stages `0..=T` of a horizon.
#[derive(Debug, Clone, PartialEq)]
pub struct HorizonRows {
    reference: Vec<[f64; 4]>,
    widths: Vec<[f64; 2]>,
}

impl HorizonRows {
    /// Rows of zeros for a horizon of `periods` control periods, which has one stage more than periods.
    pub fn new(periods: usize) -> Self {
        Self {
            reference: vec![[0.0; 4]; periods + 1],
            widths: vec![[0.0; 2]; periods + 1],
        }
    }

    /// The reference `[p_x, p_y, v_x, psi]` at each stage, in m, m, m/s and rad.
    pub fn reference(&self) -> &[[f64; 4]] {
        &self.reference
    }

    /// The distances `[left, right]` to the track's edges at each stage, in m; infinite for a path without widths.
    pub fn widths(&self) -> &[[f64; 2]] {
        &self.widths
    }

    /// The rows of [`Self::reference`] and of [`Self::widths`].
    pub fn into_parts(self) -> (Vec<[f64; 4]>, Vec<[f64; 2]>) {
        (self.reference, self.widths)
    }

    /// Writes the place `s` of a path with the speed `v` to a stage. Returns its yaw, which is within pi of `yaw`.
    fn write(&mut self, stage: usize, path: &Path, s: f64, v: f64, yaw: f64) -> f64 {
        let sample = path.sample(s);
        let yaw = yaw + wrap_angle(sample.yaw - yaw);
        self.reference[stage] = [sample.x, sample.y, v, yaw];
        self.widths[stage] = [sample.left, sample.right];
        yaw
    }
}

/// Difference in m/s up to which the reference speed may exceed the vehicle's without being changed.
const LAG: f64 = 2.0;

/// Acceleration of the limited reference, m/s²; cars reach it on snow.
const PICK_UP: f64 = 1.0;

/// Writes the rows of all stages, and returns the vehicle's projection.
///
/// Stage `k` is the point that the profile reaches from the vehicle's projection after `k dt` seconds, `ds/dt = v(s)`,
/// so the reference contains the braking and cornering of the profile. Where the profile stops, the reference stays. Yaw is
/// unwrapped: the first row is within pi of the vehicle's, and each other row within pi of the previous one. Past the end of
/// an open path the reference continues straight.
///
/// If the first speed is more than 2 m/s above [`ReferenceStart::catch_up_from`], `v_x`, the speed is at most
/// `max(v_x, 0) + 2 m/s + 1 m/s² t` after `t` seconds, and the positions are those that it leads to. Without this limit they
/// would be far ahead of the vehicle, and the cost of the speed error would exceed that of the position error.
///
/// `dt` is the control period in s. Allocates nothing.
///
/// # Errors
/// [`PathError`] if the position, yaw or hint is not finite, the period is not positive, or the profile belongs to a path
/// with another curve. Zones of friction and widths may differ.
pub fn horizon_reference(
    path: &Path,
    profile: &SpeedProfile,
    start: &ReferenceStart,
    dt: f64,
    rows: &mut HorizonRows,
) -> Result<Projection, PathError> {
    let &ReferenceStart {
        position,
        psi,
        catch_up_from,
        hint,
    } = start;
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
    if profile.curve() != path.curve() {
        return Err(PathError::ForeignProfile);
    }
    let projection = path.project(position, hint);
    let stages = rows.reference.len();
    let from = profile.unwrapped(projection.s);
    // If the profile starts at speed zero, points before its start have the time minus infinity; the reference then begins at
    // the start.
    let now = match profile.time(from) {
        f64::NEG_INFINITY => 0.0,
        time => time,
    };
    let mut yaw = psi;
    for stage in 0..stages {
        // The profile never reaches a vehicle beyond the place where it stops; the reference then stays at the vehicle.
        let s = if now.is_finite() {
            profile.station(now + stage as f64 * dt)
        } else {
            from
        };
        yaw = rows.write(stage, path, s, profile.speed_at(s), yaw);
    }
    let (Some(v_x), [_, _, first, first_yaw]) = (catch_up_from, rows.reference[0]) else {
        return Ok(projection);
    };
    if first <= v_x + LAG {
        return Ok(projection);
    }
    let (mut s, mut yaw) = (from, first_yaw);
    for stage in 0..stages {
        let most = v_x.max(0.0) + LAG + PICK_UP * stage as f64 * dt;
        let v = profile.speed_at(s).min(most);
        yaw = rows.write(stage, path, s, v, yaw);
        s += v * dt;
    }
    Ok(projection)
}
