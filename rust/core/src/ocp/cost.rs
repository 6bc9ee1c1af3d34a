//! State weights in the frame of the reference.

use nalgebra::SMatrix;

use crate::settings::Cost;
use crate::vehicle::{P_X, P_Y, PSI, V_X};
use crate::{NX, State};

/// `Q` for a reference state: weights of the position errors along and across the reference yaw and of speed and yaw
/// errors.
pub fn state_weight(cost: &Cost, reference: &State, last: bool) -> SMatrix<f64, NX, NX> {
    let factor = if last { cost.terminal } else { 1.0 };
    let (along, across) = (factor * cost.longitudinal, factor * cost.lateral);
    let (sin, cos) = reference[PSI].sin_cos();
    let mut q = SMatrix::zeros();
    q[(P_X, P_X)] = along * cos * cos + across * sin * sin;
    q[(P_Y, P_Y)] = along * sin * sin + across * cos * cos;
    q[(P_X, P_Y)] = (along - across) * sin * cos;
    q[(P_Y, P_X)] = q[(P_X, P_Y)];
    q[(V_X, V_X)] = factor * cost.v_x;
    q[(PSI, PSI)] = factor * cost.psi;
    q
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn longitudinal_and_lateral_errors_have_separate_weights() {
        let cost = Cost::default();
        let psi: f64 = 0.7;
        let mut reference = State::zeros();
        reference[PSI] = psi;
        let value = |e: State, last| (e.transpose() * state_weight(&cost, &reference, last) * e).x;
        let along = State::from_column_slice(&[psi.cos(), psi.sin(), 0.0, 0.0, 0.0, 0.0, 0.0]);
        let across = State::from_column_slice(&[-psi.sin(), psi.cos(), 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert!((value(along, false) - cost.longitudinal).abs() < 1e-12);
        assert!((value(across, false) - cost.lateral).abs() < 1e-12);
        assert!((value(across, true) - cost.terminal * cost.lateral).abs() < 1e-12);
        assert!((value(along + across, false) - cost.longitudinal - cost.lateral).abs() < 1e-12);
    }
}
