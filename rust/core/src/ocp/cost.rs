//! State weights in the frame of the reference, and their factor at the end of the horizon.

use nalgebra::SMatrix;

use crate::settings::{Cost, ScaledWeights};
use crate::vehicle::{P_X, P_Y, PSI, V_X};
use crate::{NX, State};

/// `Q` for a reference state: weights of the position errors along and across the reference yaw and of speed and yaw
/// errors. Below the reference speed `v_0` of [`ScaledWeights::full_lateral_speed`] the weight across is multiplied by
/// `(v_x / v_0)²`.
///
/// The steering angle changes at a limited rate, so that a slow vehicle which is turned away from the path needs more time than
/// the horizon to turn back, and first moves farther away from the path. With the full weight the plan with the least cost may
/// then be one that stops.
pub fn state_weight(
    cost: &Cost,
    scaled: &ScaledWeights,
    reference: &State,
) -> SMatrix<f64, NX, NX> {
    let slow = (reference[V_X] / scaled.full_lateral_speed).clamp(0.0, 1.0);
    let (along, across) = (scaled.longitudinal, scaled.lateral * slow * slow);
    let (sin, cos) = reference[PSI].sin_cos();
    let mut q = SMatrix::zeros();
    q[(P_X, P_X)] = along * cos * cos + across * sin * sin;
    q[(P_Y, P_Y)] = along * sin * sin + across * cos * cos;
    q[(P_X, P_Y)] = (along - across) * sin * cos;
    q[(P_Y, P_X)] = q[(P_X, P_Y)];
    q[(V_X, V_X)] = scaled.v_x;
    q[(PSI, PSI)] = cost.psi;
    q
}

/// Factor of the state weights at the end of the horizon on a surface with this friction:
/// `terminal / clamp(friction, 0.05, 1)`.
///
/// The weights of the last stage stand for the cost of the time after it (Rawlings, Mayne and Diehl, *Model Predictive
/// Control*, 2nd edition, section 2.5). The forces that remove an error are proportional to the friction, so on ice an
/// error costs for longer after the end of the horizon than on tarmac. With the factor of tarmac the vehicle oscillates
/// about the reference on ice with growing amplitude.
pub fn terminal_factor(cost: &Cost, friction: f64) -> f64 {
    cost.terminal / friction.clamp(LEAST_FRICTION, 1.0)
}

/// Friction below which the factor does not grow, so that the weights stay in a range that the solvers condition well.
const LEAST_FRICTION: f64 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn longitudinal_and_lateral_errors_have_separate_weights() {
        let cost = Cost::default();
        let scaled = cost.scaled(1.0);
        let psi: f64 = 0.7;
        let mut reference = State::zeros();
        (reference[PSI], reference[V_X]) = (psi, 10.0);
        let value = |e: State| (e.transpose() * state_weight(&cost, &scaled, &reference) * e).x;
        let along = State::from_column_slice(&[psi.cos(), psi.sin(), 0.0, 0.0, 0.0, 0.0, 0.0]);
        let across = State::from_column_slice(&[-psi.sin(), psi.cos(), 0.0, 0.0, 0.0, 0.0, 0.0]);
        let weights = [scaled.longitudinal, scaled.lateral];
        assert!((value(along) - weights[0]).abs() < 1e-12);
        assert!((value(across) - weights[1]).abs() < 1e-12);
        assert!((value(along + across) - weights[0] - weights[1]).abs() < 1e-12);
    }

    #[test]
    fn lateral_errors_of_slow_vehicles_weigh_less() {
        let (cost, full) = (Cost::default(), 4.0);
        let weight = |v_x: f64, scale: f64| {
            let mut reference = State::zeros();
            reference[V_X] = v_x;
            state_weight(&cost, &cost.scaled(scale), &reference)[(P_Y, P_Y)] * scale * scale
        };
        let weights = [20.0, full, 0.5 * full, 0.0].map(|v_x| weight(v_x, 1.0));
        assert_eq!(weights, [80.0, 80.0, 20.0, 0.0]);
        // A vehicle of a quarter of the size with half of the speed.
        assert_eq!(weight(0.25 * full, 0.25), 20.0);
    }

    #[test]
    fn less_friction_gives_the_end_of_the_horizon_more_weight() {
        let cost = Cost::default();
        let factor = |friction| terminal_factor(&cost, friction);
        assert_eq!([1.3, 1.0].map(factor), [cost.terminal; 2]);
        assert_eq!(factor(0.5), 2.0 * cost.terminal);
        assert_eq!(factor(1e-9), factor(LEAST_FRICTION));
    }
}
