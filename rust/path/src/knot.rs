//! What the friction ellipse allows at one knot of a speed profile.

use egp_parameters::STANDARD_GRAVITY;

use crate::limits::SpeedLimits;
use crate::path::Path;

/// Bounds of the speed at one knot.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Knot {
    /// Absolute curvature in 1/m.
    curvature: f64,
    /// Usable grip in m/s².
    grip: f64,
    /// Largest lateral acceleration in m/s².
    lateral: f64,
}

/// A place behind or ahead of a knot whose speed is known.
pub(crate) struct Neighbour<'a> {
    /// Bounds of the speed at the place.
    pub knot: &'a Knot,
    /// `v²` at the place.
    pub square: f64,
    /// Distance in m between the place and the knot.
    pub distance: f64,
}

impl Knot {
    pub fn new(curvature: f64, friction: f64, limits: &SpeedLimits) -> Self {
        let grip = limits.grip * friction * STANDARD_GRAVITY;
        Self {
            curvature,
            grip,
            lateral: limits.lateral_acceleration(friction),
        }
    }

    /// The same place in another bend.
    pub fn in_bend(self, curvature: f64) -> Self {
        Self { curvature, ..self }
    }

    /// The knots of a path, each with the lowest friction within a step.
    pub fn along(path: &Path, limits: &SpeedLimits) -> Vec<Self> {
        let step = path.step();
        (0..path.piece_count() + usize::from(!path.closed()))
            .map(|knot| {
                let s = knot as f64 * step;
                let friction = [s - step, s, s + step]
                    .map(|s| path.friction(s))
                    .into_iter()
                    .fold(f64::INFINITY, f64::min);
                Self::new(path.sample(s).curvature.abs(), friction, limits)
            })
            .collect()
    }

    /// The largest `v²` in the bend.
    pub fn cornering(&self, limits: &SpeedLimits) -> f64 {
        (limits.v_max * limits.v_max).min(self.lateral / self.curvature)
    }

    /// The largest `v²`, at most `most`, from which braking reaches the speed of the `next` place.
    pub fn before(&self, next: &Neighbour<'_>, limits: &SpeedLimits, most: f64) -> f64 {
        let &Neighbour {
            knot,
            square,
            distance,
        } = next;
        let there =
            (limits.braking * knot.grip * knot.longitudinal_share(square)).min(limits.a_brake);
        let most = most.min(square + 2.0 * distance * there);
        let here = self.reach(square, 2.0 * distance * limits.braking * self.grip);
        most.min(here).min(square + 2.0 * distance * limits.a_brake)
    }

    /// The largest `v²`, at most `most`, that drive reaches from the speed of the `previous` place.
    pub fn after(&self, previous: &Neighbour<'_>, limits: &SpeedLimits, most: f64) -> f64 {
        let &Neighbour {
            knot,
            square,
            distance,
        } = previous;
        let motor = |square: f64| limits.a_drive.min(limits.power / square.sqrt());
        let there =
            (limits.driving * knot.grip * knot.longitudinal_share(square)).min(motor(square));
        let most = most.min(square + 2.0 * distance * there);
        if most <= square {
            return most;
        }
        let here = self.reach(square, 2.0 * distance * limits.driving * self.grip);
        // The power limits the acceleration most at the faster end.
        most.min(here).min(square + 2.0 * distance * motor(most))
    }

    /// The `v²` nearest to `wanted` that the vehicle reaches from the speed of the `previous` place. Drive bounds it from
    /// above, and full braking, without regard to the bend, bounds it from below.
    pub fn within_drive_and_brakes(
        &self,
        previous: &Neighbour<'_>,
        limits: &SpeedLimits,
        wanted: f64,
    ) -> f64 {
        let slowed = 2.0 * previous.distance * previous.knot.deceleration(limits);
        let slowest = (previous.square - slowed).max(0.0);
        self.after(previous, limits, wanted).max(slowest)
    }

    /// The largest deceleration in m/s² on a straight.
    pub fn deceleration(&self, limits: &SpeedLimits) -> f64 {
        (limits.braking * self.grip).min(limits.a_brake)
    }

    /// The share of the longitudinal grip that remains when cornering at `v²`, from the friction ellipse.
    fn longitudinal_share(&self, square: f64) -> f64 {
        let load = square * self.curvature / self.lateral;
        (1.0 - load * load).max(0.0).sqrt()
    }

    /// The largest `v²` at this knot whose distance from `start` is at most `range` times the longitudinal share left
    /// at it: the larger root of `(x - start)² = range² (1 - (x / limit)²)`, where `limit` is the largest `v²` in the
    /// bend.
    fn reach(&self, start: f64, range: f64) -> f64 {
        let ratio = range * self.curvature / self.lateral;
        let a = 1.0 + ratio * ratio;
        let root = (start * start - a * (start * start - range * range)).max(0.0);
        (start + root.sqrt()) / a
    }
}
