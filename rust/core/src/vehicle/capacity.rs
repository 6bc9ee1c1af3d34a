//! What the tyres of a [`SingleTrack`] transmit at most, for the bounds of the OCP.

use std::f64::consts::FRAC_PI_2;

use egp_parameters::GRAVITY;

use super::SingleTrack;
use super::axles::Axle;

/// Largest [`SingleTrack::peak_slip`], rad. Tyres on ice, whose peaks need the largest slip of the common surfaces, peak
/// at 0.39 rad in the table of `docs/surfaces.md`. Where a fitted force peaks beyond this, the force is nearly constant.
pub const LARGEST_PEAK_SLIP: f64 = 0.4;

/// `F_x / m` in units of `g D_x` with which a vehicle reaches 96 % of its largest acceleration.
pub(super) const SATURATED: f64 = 1.5;

impl SingleTrack {
    /// Slip angle in rad at which the lateral force of the front axle is largest, `tan(pi / (2 C)) / B`, or
    /// 0.4 rad if that is less. For `C <= 1` the force rises with every slip angle and has no peak.
    pub fn peak_slip(&self) -> f64 {
        let [front, _] = &self.axles;
        if front.shape <= 1.0 {
            return LARGEST_PEAK_SLIP;
        }
        let peak = (FRAC_PI_2 / front.shape).tan() / front.stiffness;
        peak.min(LARGEST_PEAK_SLIP)
    }

    /// Largest lateral acceleration of a steady bend in units of g, `min(D_f, D_r)`: each axle then carries the share of
    /// the lateral force that it has of the load. Without a peak (`C <= 1`) an axle transmits `D sin(pi C / 2)` at most.
    pub fn largest_lateral_acceleration(&self) -> f64 {
        let peak = |axle: &Axle| axle.friction * (FRAC_PI_2 * axle.shape.min(1.0)).sin();
        let [front, rear] = &self.axles;
        peak(front).min(peak(rear))
    }

    /// Accelerations `F_x / m` in m/s², under drive and under braking, beyond which a larger force adds hardly anything: 1.5
    /// times `g D_x`, with which the vehicle reaches 96 % of its largest acceleration.
    pub fn largest_accelerations(&self) -> [f64; 2] {
        [self.grip.drive, self.grip.brake].map(|grip| SATURATED * GRAVITY * grip)
    }

    /// `(e/g)²` of the front and the rear axle, the larger one of drive and braking, in 1/(m/s²)².
    pub fn couplings(&self) -> [f64; 2] {
        self.axles
            .map(|axle| (axle.coupling.drive.max(axle.coupling.brake) / GRAVITY).powi(2))
    }

    /// Height of the centre of mass in m.
    pub fn height(&self) -> f64 {
        let [_, _, _, _, height, ..] = *self.parameters();
        height
    }
}

#[cfg(test)]
mod tests {
    use super::super::axles::Motion;
    use super::super::example::CAR;
    use super::*;
    use crate::GpInput;

    #[test]
    fn the_front_force_is_largest_at_the_peak_slip() {
        let with = |stiffness: f64, shape: f64| {
            let mut parameters = CAR;
            (parameters[10], parameters[11]) = (stiffness, shape);
            SingleTrack::new(&parameters, 0.02)
        };
        // The yaw acceleration by steering alone, from which the cosine of the steering angle is divided out.
        let force = |car: &SingleTrack, slip: f64| {
            car.change(&GpInput::new(20.0, 0.0, 0.0, slip, 0.0, 0.0))[2] / slip.cos()
        };
        for (stiffness, shape) in [(40.0, 1.35), (16.5, 1.41), (28.0, 1.9), (12.0, 1.2)] {
            let car = with(stiffness, shape);
            let peak = car.peak_slip();
            let [bound, less, most, more] =
                [0.9, 0.99, 1.0, 1.01].map(|share| force(&car, share * peak));
            assert!(
                peak < LARGEST_PEAK_SLIP && most > less && most > more,
                "{stiffness} {shape}"
            );
            // The bound of plans leaves nearly all of the force.
            assert!(bound > 0.99 * most, "{stiffness} {shape}");
        }
        // Peaks that are far out, at infinity, or do not exist.
        for shape in [1.05, 1.0, 0.9] {
            let car = with(20.0, shape);
            assert!(car.peak_slip() == LARGEST_PEAK_SLIP);
            assert!(force(&car, LARGEST_PEAK_SLIP) > force(&car, 0.99 * LARGEST_PEAK_SLIP));
        }
    }

    #[test]
    fn no_steady_bend_needs_more_than_the_largest_lateral_acceleration() {
        // The largest force of each axle over its slip angle; where the yaw moments of both axles cancel, the sum of the
        // forces is limited by one of them.
        for (front, rear, shape) in [(0.45, 0.5, 1.6), (1.0, 0.6, 1.3), (0.7, 0.9, 0.8)] {
            let mut parameters = CAR;
            (parameters[9], parameters[11]) = (front, shape);
            (parameters[14], parameters[16]) = (rear, shape);
            let car = SingleTrack::new(&parameters, 0.02);
            let axles = SingleTrack::axles(|_| &car);
            let most = (0..20_000).fold([0.0, 0.0], |most: [f64; 2], i| {
                let v_y = -0.05 * f64::from(i);
                let z = GpInput::new(20.0, v_y, 0.0, 0.0, 0.0, 0.0);
                let forces = axles.forces(&Motion::new(&z, 0.02)).lateral;
                [most[0].max(forces[0]), most[1].max(forces[1])]
            });
            let [l_f, l_r] = car.axles.map(|axle| axle.position.abs());
            let sum = (most[0] * (1.0 + l_f / l_r)).min(most[1] * (1.0 + l_r / l_f));
            let largest = GRAVITY * car.largest_lateral_acceleration();
            assert!((largest / sum - 1.0).abs() < 0.02, "{largest} {sum}");
        }
    }
}
