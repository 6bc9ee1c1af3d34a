//! The QP of eq. (18) from reference, bounds and affine dynamics.
//!
//! Inputs are scaled to `[a, delta_dot]` with `a = F_x/m`, so that both are of order one. In newtons and radians the QP
//! would be badly conditioned.

mod bounds;
mod caution;
mod cost;
mod proximal;

use egp_parameters::VehicleParameters;

use crate::linearisation::Linearisation;
use crate::qp::OcpQp;
use crate::trajectory::Guess;
use crate::vehicle::{FORCE, TyreLimits};
use crate::{Input, Settings, State};

pub use bounds::soft_rows;
pub use caution::{Caution, TransitionUncertainty};

/// Reference, track edges and what the tyres transmit along the horizon, in the vehicle's frame, rows `0..=T`.
#[derive(Debug, Clone, Copy)]
pub struct Road<'a> {
    /// Reference states: `[p_x, p_y, v_x, psi]` at their indices of a state, other entries zero.
    pub x: &'a [State],
    /// Distances `[left, right]` in m from the reference point to the track edges; empty if unknown.
    pub widths: &'a [[f64; 2]],
    /// What the tyres transmit.
    pub tyres: &'a [TyreLimits],
}

/// What all problems of one library and settings have in common.
#[derive(Debug, Clone, Copy)]
pub struct Setup<'a> {
    /// Cost, bounds and penalties.
    pub settings: &'a Settings,
    /// The vehicle to control, [`Settings::vehicle`].
    pub vehicle: &'a VehicleParameters,
    /// Period in s.
    pub dt: f64,
}

/// Fills `qp` for the measured state `x0` and the input now applied, both in the vehicle's frame and SI units. `dynamics` were
/// computed along `guess`.
///
/// With the horizon T of `qp`, `dynamics.stages` and `guess.u` have T entries, `dynamics.x`, `road.x` and `road.tyres` T+1,
/// and `road.widths` T+1 or none.
pub fn assemble(
    setup: &Setup,
    x0: &State,
    u_prev: &Input,
    dynamics: &Linearisation,
    guess: &Guess,
    road: &Road,
    qp: &mut OcpQp,
) {
    let &Setup {
        settings,
        vehicle,
        dt,
    } = setup;
    qp.x0 = *x0;
    qp.u_prev = *u_prev;
    qp.u_prev[FORCE] /= vehicle.mass;
    let scale = vehicle.scale();
    let scaled = settings.cost.scaled(scale);
    qp.r = scaled.input.into();
    qp.r_d = scaled.rate.into();
    qp.penalty = bounds::penalties(&settings.soft, scale);
    let horizon = qp.horizon();
    for (t, (stage, affine)) in qp.stages_mut().iter_mut().zip(&dynamics.stages).enumerate() {
        stage.a = affine.a;
        stage.b = affine.b;
        stage.b.column_mut(FORCE).scale_mut(vehicle.mass);
        stage.c = affine.c;
        let target = &road.x[t + 1];
        stage.q = cost::state_weight(&settings.cost, &scaled, target);
        if t + 1 == horizon {
            stage.q *= cost::terminal_factor(&settings.cost, road.tyres[t + 1].friction);
        }
        stage.reference = *target;
        bounds::soft(
            &settings.soft,
            vehicle,
            road.tyres[t + 1].slip,
            &dynamics.x[t + 1],
            target,
            road.widths.get(t + 1),
            &mut stage.soft,
        );
    }
    bounds::hard(vehicle, dt, &dynamics.x, road.x, road.tyres, qp);
    proximal::proximal(setup, road, dynamics, guess, qp);
}
