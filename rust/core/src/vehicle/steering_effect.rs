//! The effect of the front tyres' slip angle in a linearisation, which never has the wrong sign.

use egp_parameters::VehicleParameters;

use super::{OMEGA, STEERING, V_X, V_Y};
use crate::{GpInput, GpJacobian, State};

/// Raises the slope of the front axle's lateral force over its slip angle to zero, if it is negative in the Jacobian of the
/// changes over a period.
///
/// Beyond the peak of the tyres' force the tangent says that more steering turns the vehicle less. That holds near this
/// state only. A plan which has to turn less would steer farther into the bend, and the next ones still farther, until the
/// wheels are at the end of their travel, while less steering turns the vehicle less as soon as the peak is passed. Without
/// an effect of the steering, plans follow the bound on the slip, which leads back to the peak.
///
/// The slip angle is `alpha = delta - atan((v_y + l_f omega) / v_x)`, so that its slope changes the columns of `v_y` and `omega`,
/// too. That of `v_x` stays as it is, because a plan would otherwise drive faster in order to turn more. Below the speed at
/// which slip angles are defined nothing is changed.
pub(crate) fn keep_steering_effect(
    vehicle: &VehicleParameters,
    x: &State,
    jacobian: &mut GpJacobian,
) {
    let (v_x, sideways) = (x[V_X], x[V_Y] + vehicle.l_f * x[OMEGA]);
    if v_x < vehicle.slip_speed() {
        return;
    }
    // Yaw acceleration over lateral acceleration of a force at the front axle, 1/m.
    let turning = vehicle.l_f * vehicle.mass / vehicle.yaw_inertia;
    let found = jacobian[(1, STEERING)].min(jacobian[(2, STEERING)] / turning);
    if found >= 0.0 {
        return;
    }
    let by_sideways = -v_x / (v_x * v_x + sideways * sideways);
    let slip = GpInput::new(0.0, by_sideways, by_sideways * vehicle.l_f, 1.0, 0.0, 0.0).transpose();
    for (row, effect) in [(1, 1.0), (2, turning)] {
        let raised = jacobian.row(row) - found * effect * slip;
        jacobian.set_row(row, &raised);
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DELTA, SingleTrack, example::CAR};
    use super::*;

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
        let z = GpInput::new(x[V_X], x[V_Y], x[OMEGA], x[DELTA], 0.0, 0.0);
        SingleTrack::new(&CAR, 0.02).change_jacobian(&z).1
    }

    /// A vehicle that turns at `v_x` m/s with front tyres that slip by `slip`.
    fn sliding(v_x: f64, slip: f64) -> State {
        let mut x = State::zeros();
        (x[V_X], x[V_Y], x[OMEGA]) = (v_x, -0.3, 0.5);
        x[DELTA] = slip + ((x[V_Y] + vehicle().l_f * x[OMEGA]) / v_x).atan();
        x
    }

    #[test]
    fn a_slope_of_the_right_sign_stays_as_it_is() {
        // At low speed the slopes are not those of tyres.
        let negative = GpJacobian::from_element(-1.0);
        for (x, before) in [
            (sliding(15.0, 0.01), slopes(&sliding(15.0, 0.01))),
            (State::zeros(), negative),
        ] {
            let mut after = before;
            keep_steering_effect(&vehicle(), &x, &mut after);
            assert_eq!(after, before);
        }
    }

    #[test]
    fn beyond_the_peak_the_steering_has_no_effect() {
        let x = sliding(15.0, 0.3);
        let before = slopes(&x);
        assert!(before[(1, STEERING)] < 0.0 && before[(2, STEERING)] < 0.0);
        let mut after = before;
        keep_steering_effect(&vehicle(), &x, &mut after);
        let [_, l_f, ..] = CAR;
        let turning = l_f * vehicle().mass / vehicle().yaw_inertia;
        let lowest = after[(1, STEERING)].min(after[(2, STEERING)] / turning);
        assert!(lowest.abs() < 1e-12);
        // The change of the slopes is one of the front slip angle: by central differences.
        let slip = |x: &State| x[DELTA] - ((x[V_Y] + l_f * x[OMEGA]) / x[V_X]).atan();
        for (column, state) in [(1, V_Y), (2, OMEGA), (STEERING, DELTA)] {
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
