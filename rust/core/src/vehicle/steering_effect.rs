//! The least effect of the front tyres' slip angle in a linearisation.

use egp_parameters::VehicleParameters;

use super::{OMEGA, STEERING, V_X, V_Y};
use crate::{GpInput, GpJacobian, State};

/// Raises the slope of the front axle's lateral force over its slip angle to `stiffness`, if it is less in the Jacobian of the
/// changes over `dt` seconds.
///
/// `stiffness` is the slope of the vehicle's lateral acceleration in a steady bend, m/s² per rad, in which the front axle
/// carries the share `l_r / L` of the force. Beyond the peak of the tyres' force the slope is negative: the tangent says that
/// more steering turns the vehicle less. That holds near this state only. A plan which has to turn less would steer farther
/// into the bend, and the next ones still farther, until the wheels are at the end of their travel, while less steering turns
/// the vehicle less as soon as the peak is passed. The slope is therefore bounded from below, by a small share of the secant
/// from the origin to the peak. A plan that has to turn more is led back by the bound on the slip.
///
/// The slip angle is `alpha = delta - atan((v_y + l_f omega) / v_x)`, so that its slope changes the columns of `v_y` and `omega`,
/// too. That of `v_x` stays as it is, because a plan would otherwise drive faster in order to turn more. Below the speed at which
/// slip angles are defined nothing is changed.
pub(crate) fn raise_steering_effect(
    vehicle: &VehicleParameters,
    stiffness: f64,
    dt: f64,
    x: &State,
    jacobian: &mut GpJacobian,
) {
    let (v_x, sideways) = (x[V_X], x[V_Y] + vehicle.l_f * x[OMEGA]);
    if v_x < vehicle.slip_speed() {
        return;
    }
    // Yaw acceleration over lateral acceleration of a force at the front axle, 1/m.
    let turning = vehicle.l_f * vehicle.mass / vehicle.yaw_inertia;
    let least = dt * stiffness * vehicle.l_r / (vehicle.l_f + vehicle.l_r);
    let found = jacobian[(1, STEERING)].min(jacobian[(2, STEERING)] / turning);
    if found >= least {
        return;
    }
    let squared = v_x * v_x + sideways * sideways;
    let slip = GpInput::new(
        0.0,
        -v_x / squared,
        -v_x / squared * vehicle.l_f,
        1.0,
        0.0,
        0.0,
    )
    .transpose();
    for (row, effect) in [(1, 1.0), (2, turning)] {
        let raised = jacobian.row(row) + (least - found) * effect * slip;
        jacobian.set_row(row, &raised);
    }
}

#[cfg(test)]
mod tests {
    use super::super::{SingleTrack, example::CAR};
    use super::*;

    const DT: f64 = 0.02;

    fn vehicle() -> VehicleParameters {
        let [mass, l_f, l_r, squared_gyration_radius, ..] = CAR;
        VehicleParameters {
            mass,
            l_f,
            l_r,
            yaw_inertia: mass * squared_gyration_radius,
            ..VehicleParameters::FORD_ESCORT
        }
    }

    fn slopes(x: &State) -> GpJacobian {
        let z = GpInput::new(x[V_X], x[V_Y], x[OMEGA], x[6], 0.0, 0.0);
        SingleTrack::new(&CAR, DT).change_jacobian(&z).1
    }

    /// A vehicle at 15 m/s on a circle with front tyres that slip by `slip`.
    fn sliding(slip: f64) -> State {
        let mut x = State::zeros();
        (x[V_X], x[V_Y], x[OMEGA]) = (15.0, -0.3, 0.5);
        x[6] = slip + ((x[V_Y] + vehicle().l_f * x[OMEGA]) / x[V_X]).atan();
        x
    }

    #[test]
    fn a_slope_that_is_large_enough_stays_as_it_is() {
        let x = sliding(0.01);
        let before = slopes(&x);
        let mut after = before;
        raise_steering_effect(&vehicle(), 5.0, DT, &x, &mut after);
        assert_eq!(after, before);
        // At low speed the slopes of a stop are those of no tyre.
        let mut after = GpJacobian::zeros();
        raise_steering_effect(&vehicle(), 5.0, DT, &State::zeros(), &mut after);
        assert_eq!(after, GpJacobian::zeros());
    }

    #[test]
    fn beyond_the_peak_the_effect_of_steering_keeps_its_sign() {
        let x = sliding(0.3);
        let before = slopes(&x);
        assert!(before[(1, STEERING)] < 0.0 && before[(2, STEERING)] < 0.0);
        let mut after = before;
        raise_steering_effect(&vehicle(), 5.0, DT, &x, &mut after);
        let [_, l_f, l_r, ..] = CAR;
        let least = DT * 5.0 * l_r / (l_f + l_r);
        let turning = l_f * vehicle().mass / vehicle().yaw_inertia;
        let lowest = after[(1, STEERING)].min(after[(2, STEERING)] / turning);
        assert!((lowest - least).abs() < 1e-12);
        // The change of the slopes is one of the front slip angle: by central differences.
        let slip = |x: &State| x[6] - ((x[V_Y] + l_f * x[OMEGA]) / x[V_X]).atan();
        for (column, state) in [(1, V_Y), (2, OMEGA), (STEERING, 6)] {
            let step = State::ith(state, 1e-5);
            let slope = (slip(&(x + step)) - slip(&(x - step))) / 2e-5;
            for (row, effect) in [(1, 1.0), (2, turning)] {
                let change = after[(row, column)] - before[(row, column)];
                let expected = (after[(1, STEERING)] - before[(1, STEERING)]) * effect * slope;
                assert!((change - expected).abs() < 1e-9, "{row} {column}");
            }
        }
        assert_eq!(after.row(0), before.row(0));
        for other in [0, 4, 5] {
            assert_eq!(after.column(other), before.column(other));
        }
    }
}
