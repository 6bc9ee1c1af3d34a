//! Several steps of the explicit Euler method in one control period.

use nalgebra::SMatrix;

use super::STEERING;
use crate::{GpInput, GpJacobian, GpOutput, NY, NZ};

/// Number of inputs that are not among the outputs: steering angle, force and steering rate.
const REST: usize = NZ - NY;
/// Index of the steering rate in a GP input.
const STEERING_RATE: usize = NZ - 1;

/// The change of `[v_x, v_y, omega]` over `steps` steps of `step` s each, of which `change` gives one. Force and steering
/// rate stay as they are in `z`, and the steering angle follows its rate.
pub(super) fn change(
    z: &GpInput,
    steps: u32,
    step: f64,
    change: impl Fn(&GpInput) -> GpOutput,
) -> GpOutput {
    let mut total = change(z);
    for done in 1..steps {
        total += change(&after(z, &total, f64::from(done) * step));
    }
    total
}

/// Like [`change`], with the Jacobian, by the chain rule over the steps.
pub(super) fn change_jacobian(
    z: &GpInput,
    steps: u32,
    step: f64,
    change_jacobian: impl Fn(&GpInput) -> (GpOutput, GpJacobian),
) -> (GpOutput, GpJacobian) {
    let (mut total, mut jacobian) = change_jacobian(z);
    for done in 1..steps {
        let time = f64::from(done) * step;
        let (change, by) = change_jacobian(&after(z, &total, time));
        let mut state = jacobian;
        let mut diagonal = state.fixed_view_mut::<NY, NY>(0, 0);
        diagonal += SMatrix::<f64, NY, NY>::identity();
        let mut rest = SMatrix::<f64, REST, NZ>::zeros();
        for row in 0..REST {
            rest[(row, NY + row)] = 1.0;
        }
        rest[(STEERING - NY, STEERING_RATE)] = time;
        jacobian += by.fixed_columns::<NY>(0) * state + by.fixed_columns::<REST>(NY) * rest;
        total += change;
    }
    (total, jacobian)
}

/// The input `time` s after `z`, when `[v_x, v_y, omega]` have changed by `total`.
fn after(z: &GpInput, total: &GpOutput, time: f64) -> GpInput {
    let mut at = *z;
    for (value, change) in at.iter_mut().zip(total.iter()) {
        *value += change;
    }
    at[STEERING] += time * z[STEERING_RATE];
    at
}

#[cfg(test)]
mod tests {
    use crate::GpInput;
    use crate::vehicle::SingleTrack;
    use crate::vehicle::example::{CAR, check_jacobian, inputs};

    #[test]
    fn steps_are_those_of_shorter_periods() {
        let car = SingleTrack::new(&CAR, 0.05).with_steps(2);
        let half = SingleTrack::new(&CAR, 0.025);
        for z in inputs() {
            let first = half.change(&z);
            let mut middle = z;
            for d in 0..3 {
                middle[d] += first[d];
            }
            middle[3] += 0.025 * z[5];
            assert_eq!(car.change(&z), first + half.change(&middle));
        }
    }

    #[test]
    fn the_jacobian_is_that_of_finite_differences() {
        check_jacobian(&SingleTrack::new(&CAR, 0.06).with_steps(3), 1e-6);
    }

    #[test]
    fn a_slow_vehicle_is_stable_over_long_periods() {
        // One step of 0.1 s multiplies a lateral speed at 3 m/s in each period.
        let after_periods = |car: &SingleTrack| {
            let mut z = GpInput::new(3.0, 0.01, 0.0, 0.0, 0.0, 0.0);
            for _ in 0..20 {
                let change = car.change(&z);
                (z[1], z[2]) = (z[1] + change[1], z[2] + change[2]);
            }
            z[1].abs().max(z[2].abs())
        };
        let car = SingleTrack::new(&CAR, 0.1);
        assert!(after_periods(&car) > 0.1);
        assert!(after_periods(&car.with_steps(5)) < 0.001);
    }
}
