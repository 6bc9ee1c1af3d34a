//! An axle of the single-track vehicle: the lateral force of its tyres.

use egp_parameters::GRAVITY;
use nalgebra::SVector;

use super::single_track::SLOWEST;

/// Derivatives by `v_x, v_y, omega`, the steering angle in the period's middle, and `a`.
pub(super) type Gradient = SVector<f64, 5>;

/// One axle: where it is, what it carries and how its tyres hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axle {
    /// Ahead of the centre of mass, m.
    pub position: f64,
    /// 1 where it steers, otherwise 0.
    pub steers: f64,
    /// Load per mass at rest, m/s².
    pub load: f64,
    /// Change of the load with `a_x`.
    pub transfer: f64,
    /// What drive and braking cost of the lateral force.
    pub coupling: Sides,
    pub friction: f64,
    pub stiffness: f64,
    pub shape: f64,
}

/// A parameter that differs between drive and braking: they act on different axles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sides {
    pub drive: f64,
    pub brake: f64,
}

impl Sides {
    pub fn of(self, a: f64) -> f64 {
        if a > 0.0 { self.drive } else { self.brake }
    }
}

impl Axle {
    /// `e a / g`, and the share of the lateral force that drive and braking leave, `1 / sqrt(1 + (e a / g)⁴)`.
    pub fn left(&self, a: f64) -> (f64, f64) {
        let used = self.coupling.of(a) * a / GRAVITY;
        (used, 1.0 / (1.0 + used.powi(4)).sqrt())
    }

    /// Load per mass of the vehicle, m/s².
    pub fn load_at(&self, a_x: f64) -> f64 {
        self.load + self.transfer * a_x
    }

    /// The lateral force per mass of the vehicle, m/s², and its gradient.
    pub fn lateral(
        &self,
        [v_x, v_y, omega, steering, a]: [f64; 5],
        [a_x, a_x_by_a]: [f64; 2],
    ) -> (f64, Gradient) {
        let v = v_x.max(SLOWEST);
        let direction = (v_y + self.position * omega) / v;
        let slip = self.stiffness * (self.steers * steering - direction.atan());
        let (sin, cos) = (self.shape * slip.atan()).sin_cos();
        let (used, left) = self.left(a);
        let per_load = self.friction * left * sin;
        let load = self.load_at(a_x);
        let by_slip =
            load * self.friction * left * cos * self.shape * self.stiffness / (1.0 + slip * slip);
        let by_lateral_speed = -by_slip / ((1.0 + direction * direction) * v);
        let by_speed = if v_x > SLOWEST {
            -direction * by_lateral_speed
        } else {
            0.0
        };
        // Relative; in this order nothing overflows that a force could be.
        let left_by_a = -2.0 * (used * used * left) * (used * left) * self.coupling.of(a) / GRAVITY;
        let by_a = per_load * (self.transfer * a_x_by_a + load * left_by_a);
        let by = [
            by_speed,
            by_lateral_speed,
            self.position * by_lateral_speed,
            self.steers * by_slip,
            by_a,
        ];
        (per_load * load, by.into())
    }
}
