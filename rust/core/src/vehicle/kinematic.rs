//! A kinematic single-track vehicle: its wheels roll without slip, so friction has no effect.

use crate::{GpInput, GpJacobian, GpOutput, NZ};

/// Number of parameters of a [`Kinematic`].
pub const KINEMATIC_PARAMETERS: usize = 3;

/// The change of `[v_x, v_y, omega]` over one period from `z = [v_x, v_y, omega, delta, F_x, delta_dot]`.
///
/// ```text
/// v_x'   = v_x + dt F_x / m
/// omega' = v_x' tan(delta + dt delta_dot) / (l_f + l_r)
/// v_y'   = l_r omega'
/// ```
///
/// Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 2.2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kinematic {
    dt: f64,
    parameters: [f64; KINEMATIC_PARAMETERS],
}

impl Kinematic {
    /// A vehicle of the parameters `[m, l_f, l_r]` (kg, m, m), all positive, over periods of `dt` seconds.
    pub fn new(parameters: &[f64; KINEMATIC_PARAMETERS], dt: f64) -> Self {
        Self {
            dt,
            parameters: *parameters,
        }
    }

    /// The parameters, in the order of [`Kinematic::new`].
    pub fn parameters(&self) -> &[f64; KINEMATIC_PARAMETERS] {
        &self.parameters
    }

    /// The change of `[v_x, v_y, omega]` over the period.
    pub fn change(&self, z: &GpInput) -> GpOutput {
        self.change_jacobian(z).0
    }

    /// The change and its Jacobian.
    pub fn change_jacobian(&self, z: &GpInput) -> (GpOutput, GpJacobian) {
        let [v_x, v_y, omega, delta, force, delta_dot] = <[f64; NZ]>::from(*z);
        let [mass, l_f, l_r] = self.parameters;
        let per_force = self.dt / mass;
        let v_after = v_x + per_force * force;
        let tan = (delta + self.dt * delta_dot).tan();
        let curvature = tan / (l_f + l_r);
        let by_steering = v_after * (1.0 + tan * tan) / (l_f + l_r);
        let omega_after = v_after * curvature;
        // Derivatives of omega_after.
        let by = GpInput::new(
            curvature,
            0.0,
            0.0,
            by_steering,
            per_force * curvature,
            self.dt * by_steering,
        );
        let mut jacobian = GpJacobian::zeros();
        jacobian[(0, 4)] = per_force;
        jacobian.set_row(1, &(l_r * by).transpose());
        jacobian.set_row(2, &by.transpose());
        jacobian[(1, 1)] -= 1.0;
        jacobian[(2, 2)] -= 1.0;
        let after = GpOutput::new(v_after, l_r * omega_after, omega_after);
        (after - GpOutput::new(v_x, v_y, omega), jacobian)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NY;

    const CAR: [f64; KINEMATIC_PARAMETERS] = [1225.0, 0.9, 1.5];

    #[test]
    fn the_jacobian_is_that_of_finite_differences() {
        let car = Kinematic::new(&CAR, 0.02);
        let z = GpInput::new(15.0, 0.3, 0.4, 0.05, 2000.0, 0.1);
        let steps = [1e-5, 1e-5, 1e-6, 1e-6, 1e-1, 1e-5];
        let (_, jacobian) = car.change_jacobian(&z);
        for (d, step) in steps.into_iter().enumerate() {
            let shift = GpInput::ith(d, step);
            let [after, before] = [z + shift, z - shift].map(|z| car.change(&z));
            let slope = (after - before) / (2.0 * step);
            for o in 0..NY {
                assert!((slope[o] - jacobian[(o, d)]).abs() < 1e-7, "{o} {d}");
            }
        }
    }

    #[test]
    fn in_a_steady_turn_it_rolls_on_a_circle_about_the_rear_axles_line() {
        // The turn's radius at the rear axle is L / tan(delta), and that axle has no lateral speed.
        let (v, delta) = (8.0, 0.2_f64);
        let omega = v / (2.4 / delta.tan());
        let z = GpInput::new(v, 1.5 * omega, omega, delta, 0.0, 0.0);
        assert!(Kinematic::new(&CAR, 0.02).change(&z).amax() < 1e-14);
    }
}
