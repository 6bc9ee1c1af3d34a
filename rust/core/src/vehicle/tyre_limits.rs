//! What the tyres transmit.

use std::ops::{AddAssign, Mul};

/// Limits beyond which the tyres of one surface, or of a blend of surfaces, transmit no more.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TyreLimits {
    /// Friction coefficient of the surface.
    pub friction: f64,
    /// Slip angle of the front tyres at the peak of their force, rad.
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
}

impl Mul<f64> for TyreLimits {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self {
            friction: self.friction * factor,
            slip: self.slip * factor,
            drive: self.drive * factor,
            brake: self.brake * factor,
            coupling: self.coupling.map(|value| value * factor),
            transfer: self.transfer * factor,
        }
    }
}

impl AddAssign for TyreLimits {
    fn add_assign(&mut self, other: Self) {
        self.friction += other.friction;
        self.slip += other.slip;
        self.drive += other.drive;
        self.brake += other.brake;
        for (value, added) in self.coupling.iter_mut().zip(other.coupling) {
            *value += added;
        }
        self.transfer += other.transfer;
    }
}
