//! The largest forces and slip that the tyres of a surface transmit.

use super::capacity::SATURATED;

/// Limits beyond which the tyres of one surface, or of a blend of surfaces, transmit no more.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TyreLimits {
    /// Friction coefficient of the surface.
    pub friction: f64,
    /// Slip angle of the front tyres to which plans are bounded, rad: close to the peak of their force.
    pub slip: f64,
    /// Largest acceleration `F_x / m` under drive, m/s².
    pub drive: f64,
    /// Largest deceleration `-F_x / m` under braking, m/s².
    pub brake: f64,
    /// `(e/g)²` of the front and the rear axle, the larger one of drive and braking, in 1/(m/s²)²: what `F_x / m` costs of
    /// the axle's lateral force.
    pub coupling: [f64; 2],
    /// Share of the load of the wheels inside a bend that moves to those outside, for each m/s² of lateral acceleration.
    pub transfer: f64,
    /// Largest lateral acceleration in a steady bend, m/s².
    pub lateral: f64,
    /// Share of `brake` that is allowed: 1 but on a road with less friction than that of all surfaces.
    pub braking: f64,
}

/// Share of [`TyreLimits::drive`] or [`TyreLimits::brake`] for wheels that have to transmit lateral force. At the limits, 1.5
/// `g D_x`, the wheels spin or lock. At 0.7 `g D_x` the vehicle has 66 % of its largest acceleration and spinning wheels regain
/// grip; at 0.8 they do not.
pub(crate) const ROLLING: f64 = 0.7 / SATURATED;

/// Friction coefficient below which a surface is slippery: drive and braking are bounded by what the lateral force leaves
/// ([`TyreLimits::share_beside`]), and horizons are longer by default. `docs/problem.md`, section 6, says why this bound is left
/// out on other surfaces.
pub(crate) const SLIPPERY: f64 = 0.5;

/// Ratio of frictions at which the share of the braking has fallen to [`ROLLING`].
const FAR_BELOW: f64 = 0.7;

impl TyreLimits {
    /// Adds `weight` times other limits.
    pub(crate) fn add(&mut self, weight: f64, other: &Self) {
        self.friction += weight * other.friction;
        self.slip += weight * other.slip;
        self.drive += weight * other.drive;
        self.brake += weight * other.brake;
        self.coupling = [0, 1].map(|axle| self.coupling[axle] + weight * other.coupling[axle]);
        self.transfer += weight * other.transfer;
        self.lateral += weight * other.lateral;
    }

    /// The share of `drive` and `brake` that is left while the tyres also transmit a lateral force.
    ///
    /// It is that of the friction ellipse, `sqrt(1 - used²)`, but at least [`ROLLING`], with which wheels go on rolling; from
    /// the friction [`SLIPPERY`] on it is 1. `used` is the larger one of two ratios: the lateral acceleration `lateral`, m/s²,
    /// over the largest one of a steady bend, and `front_slip`, rad, over its bound. The
    /// second ratio also detects front tyres that slide while the vehicle does not turn, and the first one detects rear tyres
    /// at their limit.
    pub(crate) fn share_beside(&self, lateral: f64, front_slip: f64) -> f64 {
        if self.friction >= SLIPPERY {
            return 1.0;
        }
        let used = (lateral / self.lateral)
            .abs()
            .max((front_slip / self.slip).abs());
        (1.0 - used * used).max(ROLLING * ROLLING).sqrt()
    }

    /// The limits on a road with at most `ratio` times the friction coefficient of these tyres; for ratios from 1 on they are
    /// the same.
    ///
    /// If the members assume more friction than the road has, the linearised model overestimates the lateral force under
    /// braking. The plan would then brake until the wheels lock, which removes the lateral force. Braking is therefore limited
    /// to what keeps the wheels rolling.
    pub(crate) fn on_less_friction(self, ratio: f64) -> Self {
        let ratio = ratio.min(1.0);
        let far = ((1.0 - ratio) / (1.0 - FAR_BELOW)).min(1.0);
        Self {
            drive: self.drive * ratio,
            brake: self.brake * ratio,
            lateral: self.lateral * ratio,
            braking: 1.0 - (1.0 - ROLLING) * far,
            ..self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forces_fall_with_the_friction_and_braking_leaves_the_wheels_rolling() {
        let tyres = TyreLimits {
            friction: 0.5,
            slip: 0.1,
            drive: 3.0,
            brake: 6.0,
            coupling: [0.2, 0.3],
            transfer: 0.08,
            lateral: 4.0,
            braking: 1.0,
        };
        let forces = |ratio: f64| {
            let limits = tyres.on_less_friction(ratio);
            assert_eq!(limits.lateral, 4.0 * ratio.min(1.0));
            let TyreLimits {
                drive,
                brake,
                lateral,
                braking,
                ..
            } = tyres;
            assert_eq!(
                TyreLimits {
                    drive,
                    brake,
                    lateral,
                    braking,
                    ..limits
                },
                tyres,
                "only forces change"
            );
            [limits.drive, limits.brake * limits.braking]
        };
        for ratio in [1.0, 2.0, f64::INFINITY] {
            assert_eq!(forces(ratio), [3.0, 6.0]);
        }
        for (ratio, expected) in [
            (0.5, [1.5, 0.5 * 2.8]),
            (FAR_BELOW, [2.1, FAR_BELOW * 2.8]),
            (0.85, [2.55, 0.85 * 4.4]),
        ] {
            let difference = [0, 1].map(|i| (forces(ratio)[i] - expected[i]).abs());
            assert!(
                difference.iter().all(|value| *value < 1e-12),
                "{ratio} {difference:?}"
            );
        }
    }
    #[test]
    fn beside_a_lateral_force_tyres_transmit_what_the_friction_ellipse_leaves() {
        let tyres = TyreLimits {
            friction: 0.3,
            slip: 0.1,
            lateral: 5.0,
            ..TyreLimits::default()
        };
        let share = |lateral, slip| tyres.share_beside(lateral, slip);
        assert_eq!(share(0.0, 0.0), 1.0);
        for sign in [-1.0, 1.0] {
            assert!((share(sign * 3.0, 0.0) - 0.8).abs() < 1e-12);
            assert!((share(0.0, sign * 0.06) - 0.8).abs() < 1e-12);
        }
        // The larger share counts.
        assert!((share(3.0, 0.08) - 0.6).abs() < 1e-12);
        assert!((share(4.0, 0.06) - 0.6).abs() < 1e-12);
        for beyond in [share(5.0, 0.0), share(0.0, 0.1), share(50.0, 0.0)] {
            assert!((beyond - ROLLING).abs() < 1e-12);
        }
        let friction = SLIPPERY;
        let rough = TyreLimits { friction, ..tyres };
        assert_eq!(rough.share_beside(50.0, 1.0), 1.0);
    }
}
