//! Classical Runge-Kutta integration and its longest substep.

use crate::dynamics::{KINEMATIC_SPEED, disturbed_derivative};
use crate::effects::Effects;
use crate::state::{NX, StateVector};
use crate::{Parameters, PlantError, Surface};

/// Longest substep at any speed, s.
pub const MAX_SUBSTEP: f64 = 5e-3;

/// Longest stable and accurate substep at speed `v_x`, s, where surfaces scale the stiffness by at most `stiffness` and a load
/// of `weight` N may act on one wheel beside the static one.
///
/// The stiffest mode is the relaxation of a wheel's spin to the rolling speed through its slip stiffness, with the time
/// constant `tau = I v_x / (R² K)`, `K = p_kx1 F_z`: 2.5 ms at 15 m/s, 0.2 ms at 1 m/s. Fourth-order Runge-Kutta is
/// stable up to `2.78 tau`; `2 tau` at this load leaves a margin for load transfer. A lower stiffness does not lengthen the
/// substep, because the other modes have the same time constants. At walking speed there is no slip.
pub fn longest_substep(parameters: &Parameters, v_x: f64, stiffness: f64, weight: f64) -> f64 {
    if v_x < KINEMATIC_SPEED {
        return MAX_SUBSTEP;
    }
    let [front, rear] = parameters.static_wheel_loads();
    let wheel = &parameters.wheel;
    let stiffness = stiffness.max(1.0) * parameters.tyre.p_kx1 * (front.max(rear) + weight);
    let tau = wheel.inertia * v_x / (wheel.radius * wheel.radius * stiffness);
    MAX_SUBSTEP.min(2.0 * tau)
}

/// The state after `h` seconds under constant input and surfaces.
pub(crate) fn rk4(
    parameters: &Parameters,
    effects: &Effects,
    x: &StateVector,
    input: [f64; 2],
    surfaces: &[Surface; 4],
    h: f64,
) -> Result<StateVector, PlantError> {
    let slope = |x: &StateVector| disturbed_derivative(parameters, effects, x, input, surfaces);
    let k1 = slope(x)?;
    let k2 = slope(&along(x, &k1, 0.5 * h))?;
    let k3 = slope(&along(x, &k2, 0.5 * h))?;
    let k4 = slope(&along(x, &k3, h))?;
    let mut next = *x;
    for i in 0..NX {
        next[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
    }
    Ok(next)
}

fn along(x: &StateVector, slope: &StateVector, h: f64) -> StateVector {
    let mut moved = *x;
    for i in 0..NX {
        moved[i] += h * slope[i];
    }
    moved
}
