//! Eq. (11): known kinematics, learned dynamics by the GP output.

use nalgebra::SMatrix;

use super::{DELTA, DELTA_DOT, OMEGA, P_X, P_Y, PSI, V_X, V_Y, VELOCITIES};
use crate::{GpInput, GpJacobian, GpOutput, Input, NU, NX, State};

/// States a GP input holds, in its order; the inputs follow.
const STATES: [usize; 4] = [V_X, V_Y, OMEGA, DELTA];

/// The GP input `z = [v_x, v_y, omega, delta, F_x, delta_dot]` of a state and an input.
pub fn gp_input(x: &State, u: &Input) -> GpInput {
    GpInput::new(x[V_X], x[V_Y], x[OMEGA], x[DELTA], u[0], u[1])
}

/// The next state, eq. (11), where `change` is the GP output at [`gp_input`] and `dt` the period in s.
///
/// Positions move along the yaw at the share `yaw_at` of the period: 0 is the paper's forward Euler method, 1/2 is right to
/// second order in a steady bend. With the Euler method the position drifts outwards at `v omega dt / 2` m/s, where `v` is the
/// speed: 6 cm over 0.8 s at 15 m/s, 0.5 rad/s and 20 ms; a controller that uses it drives on the inside of the bend. `v_x`
/// and `v_y` are those at the start of the period, so that under braking at 8 m/s² the predicted path is also 6 cm too long
/// after 0.8 s.
pub fn successor(x: &State, u: &Input, change: &GpOutput, dt: f64, yaw_at: f64) -> State {
    let (sin, cos) = (x[PSI] + yaw_at * dt * x[OMEGA]).sin_cos();
    let mut next = *x;
    next[P_X] += (x[V_X] * cos - x[V_Y] * sin) * dt;
    next[P_Y] += (x[V_X] * sin + x[V_Y] * cos) * dt;
    next[PSI] += x[OMEGA] * dt;
    next[DELTA] += u[DELTA_DOT] * dt;
    for (row, &state) in VELOCITIES.iter().enumerate() {
        next[state] += change[row];
    }
    next
}

/// Jacobians of [`successor`] with respect to state and input, given the GP's own `[3, 6]`.
pub fn jacobians(
    x: &State,
    gp: &GpJacobian,
    dt: f64,
    yaw_at: f64,
) -> (SMatrix<f64, NX, NX>, SMatrix<f64, NX, NU>) {
    let (sin, cos) = (x[PSI] + yaw_at * dt * x[OMEGA]).sin_cos();
    let mut a = SMatrix::<f64, NX, NX>::identity();
    let mut b = SMatrix::<f64, NX, NU>::zeros();
    a[(P_X, V_X)] = cos * dt;
    a[(P_X, V_Y)] = -sin * dt;
    a[(P_X, PSI)] = (-x[V_X] * sin - x[V_Y] * cos) * dt;
    a[(P_Y, V_X)] = sin * dt;
    a[(P_Y, V_Y)] = cos * dt;
    a[(P_Y, PSI)] = (x[V_X] * cos - x[V_Y] * sin) * dt;
    a[(P_X, OMEGA)] = yaw_at * dt * a[(P_X, PSI)];
    a[(P_Y, OMEGA)] = yaw_at * dt * a[(P_Y, PSI)];
    a[(PSI, OMEGA)] = dt;
    b[(DELTA, DELTA_DOT)] = dt;
    for (row, &output) in VELOCITIES.iter().enumerate() {
        for (column, &state) in STATES.iter().enumerate() {
            a[(output, state)] += gp[(row, column)];
        }
        for input in 0..NU {
            b[(output, input)] = gp[(row, STATES.len() + input)];
        }
    }
    (a, b)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth stand-in for the GP with every entry of its Jacobian non-zero.
    fn change(z: &GpInput) -> GpOutput {
        GpOutput::new(
            (0.3 * z[0] * z[3] + z[4] * 1e-3).sin() + z[1] * z[2] * 0.1 + z[5],
            (z[0] * 0.2 - z[1] + z[2] * z[5]).cos() + z[3] * z[4] * 1e-3,
            (z[0] * z[1] * z[2]).tanh() + z[3].powi(2) + z[4] * z[5] * 1e-3,
        )
    }

    fn central<const N: usize>(
        f: impl Fn(f64) -> nalgebra::SVector<f64, N>,
        h: f64,
    ) -> nalgebra::SVector<f64, N> {
        (f(h) - f(-h)) / (2.0 * h)
    }

    #[test]
    fn jacobians_agree_with_finite_differences() {
        let x = State::from_column_slice(&[3.0, -2.0, 4.0, 0.7, 0.4, -0.3, 0.1]);
        let u = Input::new(200.0, 0.2);
        let f = |x: &State, u: &Input| successor(x, u, &change(&gp_input(x, u)), 0.05, 0.5);
        let mut gp = GpJacobian::zeros();
        for j in 0..6 {
            let step = if j == 4 { 1e-2 } else { 1e-6 };
            gp.set_column(
                j,
                &central(
                    |h| change(&(gp_input(&x, &u) + h * GpInput::ith(j, 1.0))),
                    step,
                ),
            );
        }
        let (a, b) = jacobians(&x, &gp, 0.05, 0.5);
        for j in 0..NX {
            let difference = central(|h| f(&(x + h * State::ith(j, 1.0)), &u), 1e-6);
            assert!((a.column(j) - difference).amax() < 1e-8, "state {j}");
        }
        for j in 0..NU {
            let step = if j == 0 { 1e-2 } else { 1e-6 };
            let difference = central(|h| f(&x, &(u + h * Input::ith(j, 1.0))), step);
            assert!((b.column(j) - difference).amax() < 1e-8, "input {j}");
        }
    }

    #[test]
    fn straight_motion_is_exact() {
        let x =
            State::from_column_slice(&[1.0, 2.0, 10.0, std::f64::consts::FRAC_PI_2, 0.5, 0.0, 0.0]);
        let next = successor(&x, &Input::zeros(), &GpOutput::zeros(), 0.1, 0.5);
        let expected = State::from_column_slice(&[1.0 - 0.05, 3.0, 10.0, x[PSI], 0.5, 0.0, 0.0]);
        assert!((next - expected).amax() < 1e-15);
    }

    #[test]
    fn positions_leave_a_steady_bend_by_the_euler_method_only() {
        let (v, omega, dt, periods) = (15.0, 0.5, 0.02, 40);
        let end = f64::from(periods) * dt;
        let bend = v / omega * (1.0 - (omega * end).cos());
        let leaves_by = |yaw_at: f64| {
            let mut x = State::from_column_slice(&[0.0, 0.0, v, 0.0, 0.0, omega, 0.0]);
            for _ in 0..periods {
                x = successor(&x, &Input::zeros(), &GpOutput::zeros(), dt, yaw_at);
            }
            bend - x[P_Y]
        };
        assert!(leaves_by(0.5).abs() < 1e-4);
        assert!((leaves_by(0.0) - 0.06).abs() < 0.005);
    }
}
