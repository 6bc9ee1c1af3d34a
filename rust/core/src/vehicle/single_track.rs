//! A single-track vehicle with saturating tyres, the prior mean of a member's Gaussian processes.

use std::ops::AddAssign;

use egp_parameters::{GRAVITY, slip_speed};
use nalgebra::{SMatrix, SVector};

use super::axles::{Axle, Axles, Forces, Motion, Sides, Slopes};
use super::euler;
use super::resistance::Resistance;
use crate::{GpInput, GpJacobian, GpOutput, NY};

/// Number of parameters of a [`SingleTrack`].
pub const SINGLE_TRACK_PARAMETERS: usize = 17;
/// Powers of a factor on the friction in the parameters, in the order of [`SingleTrack::new`]: what the tyres transmit
/// is proportional to it, and their slope at zero slip, `B C D`, does not depend on it.
const FRICTION_POWERS: [i32; SINGLE_TRACK_PARAMETERS] =
    [0, 0, 0, 0, 0, 1, 1, -1, -1, 1, -1, 0, -1, -1, 1, -1, 0];

/// The change of `[v_x, v_y, omega]` over one period from `z = [v_x, v_y, omega, delta, F_x, delta_dot]`, by one step or
/// several of the explicit Euler method with the steering angle of the step's middle.
///
/// With `a = F_x / m`, slip angles `alpha = delta - atan((v_y + l omega) / v_x)` (no `delta` at the rear, and `v_x` at least
/// the [`slip_speed`] of `l_f + l_r`) and axle loads per mass `n`, which braking moves to the front:
///
/// ```text
/// a_x = a / (1 + (a / (g D_x))⁴)^¼                          what the tyres transmit
/// f   = n D sin(C atan(B alpha)) / sqrt(1 + (e a / g)⁴)     lateral, less under braking and drive
/// dv_x/dt   = a_x - f_f sin(delta) + v_y omega - r(v_x)
/// dv_y/dt   = f_f cos(delta) + f_r - v_x omega
/// domega/dt = (l_f f_f cos(delta) - l_r f_r) / k²
/// ```
///
/// The [`Resistance`] `r` is zero unless stated.
///
/// `D_x`, and `e` of each axle, are one number for drive and another for braking: a vehicle that drives one axle and
/// brakes two spins its wheels long before it locks them, and a driven axle with spinning wheels transmits no lateral force.
///
/// Rajamani, *Vehicle Dynamics and Control*, 2nd ed., sections 2.3 and 13.9 (tyre curve after Pacejka); the saturation
/// of `a_x` and the coupling `e` are smooth stand-ins for the friction circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingleTrack {
    /// Length of a step of the Euler method, s.
    step: f64,
    /// Number of these steps in a period.
    steps: u32,
    mass: f64,
    /// Lowest speed at which slip angles are computed, m/s.
    slip_speed: f64,
    /// Radius of gyration squared, m².
    squared_gyration_radius: f64,
    pub(super) grip: Sides,
    pub(super) axles: [Axle; 2],
    resistance: Resistance,
    parameters: [f64; SINGLE_TRACK_PARAMETERS],
}

impl SingleTrack {
    /// A vehicle of the parameters `[m, l_f, l_r, k², h]` (kg, m, m, m², m), `D_x` under drive and braking, and for the
    /// front, then the rear axle `e` under drive and braking, `D`, `B` and `C`; all positive, over periods of `dt`
    /// seconds, by one step of the Euler method.
    pub fn new(parameters: &[f64; SINGLE_TRACK_PARAMETERS], dt: f64) -> Self {
        let [
            mass,
            l_f,
            l_r,
            squared_gyration_radius,
            height,
            drive,
            brake,
            tyres @ ..,
        ] = *parameters;
        let per_wheelbase = 1.0 / (l_f + l_r);
        let axle = |position: f64, [drive, brake, friction, stiffness, shape]: [f64; 5]| Axle {
            position,
            steers: f64::from(position > 0.0),
            load: GRAVITY * (l_f + l_r - position.abs()) * per_wheelbase,
            transfer: -position.signum() * height * per_wheelbase,
            coupling: Sides { drive, brake },
            friction,
            stiffness,
            shape,
        };
        let [ef_d, ef_b, d_f, b_f, c_f, er_d, er_b, d_r, b_r, c_r] = tyres;
        Self {
            step: dt,
            steps: 1,
            mass,
            slip_speed: slip_speed(l_f + l_r),
            squared_gyration_radius,
            grip: Sides { drive, brake },
            axles: [
                axle(l_f, [ef_d, ef_b, d_f, b_f, c_f]),
                axle(-l_r, [er_d, er_b, d_r, b_r, c_r]),
            ],
            resistance: Resistance::default(),
            parameters: *parameters,
        }
    }

    /// The same vehicle with `steps >= 1` steps of the Euler method in a period.
    #[must_use]
    pub fn with_steps(self, steps: u32) -> Self {
        let step = self.step * f64::from(self.steps) / f64::from(steps);
        Self {
            step,
            steps,
            ..self
        }
    }

    /// Number of steps of the Euler method in a period.
    pub fn steps(&self) -> u32 {
        self.steps
    }

    /// A vehicle of other parameters, with the steps of this one.
    fn with_parameters(&self, parameters: &[f64; SINGLE_TRACK_PARAMETERS]) -> Self {
        let steps = self.steps;
        Self {
            steps,
            ..Self::new(parameters, self.step)
        }
    }

    /// The same vehicle with another resistance.
    #[must_use]
    pub fn with_resistance(self, resistance: Resistance) -> Self {
        Self { resistance, ..self }
    }

    /// The same vehicle on a road of `ratio` times the friction: its tyres transmit `ratio` times the force, with the
    /// same slope at zero slip.
    pub(crate) fn with_friction(&self, ratio: f64) -> Self {
        let scaled = |i: usize| self.parameters[i] * ratio.powi(FRICTION_POWERS[i]);
        self.with_parameters(&std::array::from_fn(scaled))
            .with_resistance(self.resistance)
    }

    /// Geometric mean of the axles' `D`.
    pub(crate) fn lateral_grip(&self) -> f64 {
        (self.axles[0].friction * self.axles[1].friction).sqrt()
    }

    /// The vehicle whose parameters lie at `share` of the way to those of `other`, geometrically, and its resistance
    /// linearly.
    pub(crate) fn between(&self, other: &Self, share: f64) -> Self {
        let blend = |a: f64, b: f64| a * (b / a).powf(share);
        let blended = |i: usize| blend(self.parameters[i], other.parameters[i]);
        self.with_parameters(&std::array::from_fn(blended))
            .with_resistance(self.resistance.between(&other.resistance, share))
    }

    /// The parameters, in the order of [`SingleTrack::new`].
    pub fn parameters(&self) -> &[f64; SINGLE_TRACK_PARAMETERS] {
        &self.parameters
    }

    /// Rolling resistance and drag.
    pub fn resistance(&self) -> Resistance {
        self.resistance
    }

    /// The change of `[v_x, v_y, omega]` over the period.
    pub fn change(&self, z: &GpInput) -> GpOutput {
        let axles = Self::axles(|_| self);
        euler::change(z, self.steps, self.step, |z| {
            let motion = Motion::new(z, self.step);
            self.change_by(&motion, &axles.forces(&motion), 0)
        })
    }

    /// The change and its Jacobian.
    pub fn change_jacobian(&self, z: &GpInput) -> (GpOutput, GpJacobian) {
        let axles = Self::axles(|_| self);
        euler::change_jacobian(z, self.steps, self.step, |z| {
            let motion = Motion::new(z, self.step);
            let (forces, slopes) = axles.forces_and_slopes(&motion);
            self.change_jacobian_by(&motion, &forces, &slopes, 0)
        })
    }

    /// The axles of several vehicles.
    pub(super) fn axles<'a>(of: impl Fn(usize) -> &'a Self) -> Axles {
        Axles::new(|place| {
            let vehicle = of(place);
            (
                vehicle.mass,
                vehicle.slip_speed,
                vehicle.grip,
                vehicle.axles,
            )
        })
    }

    /// The change over one step, from the forces of the axles, of which this vehicle's are at the given place.
    pub(super) fn change_by(&self, motion: &Motion, forces: &Forces, place: usize) -> GpOutput {
        let Motion {
            v_x, v_y, omega, ..
        } = *motion;
        let a_x = forces.longitudinal[2 * place];
        let ahead = a_x + v_y * omega - self.resistance.deceleration(v_x, self.slip_speed);
        let mut rate = GpOutput::new(ahead, -v_x * omega, 0.0);
        for (axle, f) in self.axles.iter().zip(&forces.lateral[2 * place..]) {
            rate += *f * self.across(axle, motion);
        }
        rate * self.step
    }

    /// Like [`Self::change_by`], with the Jacobian.
    pub(super) fn change_jacobian_by(
        &self,
        motion: &Motion,
        forces: &Forces,
        slopes: &Slopes,
        place: usize,
    ) -> (GpOutput, GpJacobian) {
        let Motion {
            v_x, v_y, omega, ..
        } = *motion;
        // By v_x, v_y, omega, the steering angle, and a.
        let mut by = SMatrix::<f64, NY, 5>::zeros();
        let a_x_by_a = slopes.longitudinal[2 * place];
        (by[(0, 1)], by[(0, 2)], by[(0, 4)]) = (omega, v_y, a_x_by_a);
        by[(0, 0)] -= self.resistance.slope(v_x, self.slip_speed);
        (by[(1, 0)], by[(1, 2)]) = (-omega, -v_x);
        for (lane, axle) in (2 * place..).zip(&self.axles) {
            let [speed, lateral, steering, a] = slopes.lateral.map(|slope| slope[lane]);
            let gradient = SVector::from([speed, lateral, axle.position * lateral, steering, a]);
            by += self.across(axle, motion) * gradient.transpose();
            if axle.steers > 0.0 {
                let (sin, cos) = motion.turned;
                let lever = axle.position / self.squared_gyration_radius;
                let turning = forces.lateral[lane] * GpOutput::new(-cos, -sin, -lever * sin);
                by.column_mut(3).add_assign(&turning);
            }
        }
        let mut jacobian = GpJacobian::zeros();
        jacobian
            .fixed_columns_mut::<4>(0)
            .copy_from(&(by.fixed_columns::<4>(0) * self.step));
        jacobian.set_column(4, &(by.column(4) * (self.step / self.mass)));
        jacobian.set_column(5, &(by.column(3) * (0.5 * self.step * self.step)));
        (self.change_by(motion, forces, place), jacobian)
    }

    /// Accelerations of `[v_x, v_y, omega]` by a unit of lateral force per mass at the axle.
    fn across(&self, axle: &Axle, motion: &Motion) -> GpOutput {
        let (sin, cos) = if axle.steers > 0.0 {
            motion.turned
        } else {
            (0.0, 1.0)
        };
        GpOutput::new(
            -sin,
            cos,
            axle.position / self.squared_gyration_radius * cos,
        )
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::example::{CAR, MODEL_CAR, check_jacobian, inputs};
    use super::*;

    const RESISTANCE: Resistance = Resistance {
        rolling: 0.15,
        drag: 4e-4,
    };

    #[test]
    fn the_jacobian_is_that_of_finite_differences() {
        let car = SingleTrack::new(&CAR, 0.02).with_resistance(RESISTANCE);
        check_jacobian(&car, 1e-7);
    }

    #[test]
    fn a_model_car_has_slip_at_a_speed_at_which_that_of_a_large_one_is_not_defined() {
        // Without yaw rate and steering the rear force depends on the slip angle alone.
        let by_speed = |parameters| {
            let car = SingleTrack::new(parameters, 0.02);
            let sliding = |v_x: f64| car.change(&GpInput::new(v_x, -0.1, 0.0, 0.0, 0.0, 0.0))[1];
            sliding(2.0) - sliding(2.5)
        };
        assert_eq!(by_speed(&CAR), 0.0);
        assert!(by_speed(&MODEL_CAR) > 0.01);
        let z = GpInput::new(2.0, 0.1, 0.3, 0.3, 5.0, 0.4);
        let car = SingleTrack::new(&MODEL_CAR, 0.02);
        let (value, jacobian) = car.change_jacobian(&z);
        let shift = GpInput::new(1e-6, 0.0, 0.0, 0.0, 0.0, 0.0);
        assert_eq!(value, car.change(&z));
        let slope = (car.change(&(z + shift)) - car.change(&(z - shift))) / 2e-6;
        assert!((slope - jacobian.column(0)).amax() < 1e-6);
    }

    #[test]
    fn it_is_symmetric_and_rests_when_driven_straight() {
        let car = SingleTrack::new(&CAR, 0.02);
        for z in inputs() {
            let mirror = GpInput::new(z[0], -z[1], -z[2], -z[3], z[4], -z[5]);
            let (here, there) = (car.change(&z), car.change(&mirror));
            assert_eq!(here, GpOutput::new(there[0], -there[1], -there[2]));
        }
        let straight = GpInput::new(20.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        assert_eq!(car.change(&straight), GpOutput::zeros());
    }

    #[test]
    fn it_turns_as_its_understeer_gradient_says() {
        // Small angles: delta = omega (L / v + K v), K = (1 / s_f - 1 / s_r) / g with s = B C D of an axle, here by
        // Newton's method on v_y and omega.
        let car = SingleTrack::new(&CAR, 0.02);
        let [slope_f, slope_r] = [9, 14].map(|d| CAR[d] * CAR[d + 1] * CAR[d + 2]); // B C D
        let (v, delta) = (20.0, 1e-4);
        let mut z = GpInput::new(v, 0.0, 0.0, delta, 0.0, 0.0);
        for _ in 0..5 {
            let (change, slopes) = car.change_jacobian(&z);
            let lateral = slopes.fixed_view::<2, 2>(1, 1).into_owned();
            let step = lateral.try_inverse().unwrap() * change.fixed_rows::<2>(1);
            (z[1], z[2]) = (z[1] - step[0], z[2] - step[1]);
        }
        let wheelbase = CAR[1] + CAR[2];
        let gradient = (1.0 / slope_f - 1.0 / slope_r) / GRAVITY;
        let omega = v * delta / (wheelbase + gradient * v * v);
        assert!((z[2] / omega - 1.0).abs() < 1e-6, "{} {omega}", z[2]);
    }

    #[test]
    fn braking_loads_the_front() {
        let car = SingleTrack::new(&CAR, 0.02);
        let turning_in =
            |force: f64| car.change(&GpInput::new(20.0, 0.0, 0.0, 0.02, force, 0.0))[2];
        assert!(turning_in(-1500.0) > turning_in(0.0));
    }

    #[test]
    fn a_driven_axle_that_spins_does_not_steer() {
        let car = SingleTrack::new(&CAR, 0.02);
        let turning_in = |force: f64| car.change(&GpInput::new(9.0, 0.0, 0.0, 0.1, force, 0.0))[2];
        assert!(turning_in(1000.0) > 0.9 * turning_in(0.0));
        assert!(turning_in(10_000.0) < 0.5 * turning_in(0.0));
    }

    #[test]
    fn tyres_saturate() {
        let car = SingleTrack::new(&CAR, 0.02);
        let change = |force: f64| car.change(&GpInput::new(20.0, 0.0, 0.0, 0.0, force, 0.0))[0];
        assert!((change(-1000.0) + 0.02 * 1000.0 / 1225.0).abs() < 1e-4);
        assert!(change(-1e6) > -0.02 * GRAVITY * 0.8 - 1e-9);
        assert!(change(1e6) < 0.02 * GRAVITY * 0.5 + 1e-9);
    }
}
