//! The proximal term on the force, which keeps consecutive plans from alternating.

use super::{Road, Setup};
use crate::linearisation::Linearisation;
use crate::qp::OcpQp;
use crate::trajectory::Guess;
use crate::vehicle::{FORCE, OMEGA, V_X, V_Y};
use crate::{Input, State};

/// Largest value of `|d²/du² (1 + u⁴)^(-1/2)|`, the curvature of the lateral force that drive and braking leave.
const LARGEST_CURVATURE: f64 = 1.393;

/// Largest weight, 1/(m/s²)². A heavier weight holds the force as well as this one does, and the problem would be badly
/// conditioned.
const LARGEST_WEIGHT: f64 = 100.0;

/// Weighs the difference between the force of each stage and that of the previous plan, by `cost.proximal` times a bound on
/// the curvature that the linearisation leaves out.
///
/// Drive and braking reduce the lateral force, `f(a) = f(0) (1 + (e a/g)⁴)^(-1/2)` for each axle. Near the friction limit this
/// is a concave function of `a`. Its tangent at a braking plan overestimates the force at less braking, its tangent at a
/// driving plan that at less drive, so that consecutive plans alternate between both limits. In the Lagrangian the missing
/// term is `p_f f(a)` with the multiplier `p_f` of the axle's force; its curvature in `a` is at most
///
/// ```text
/// d_t = Σ_axles max(0, -p_f f(0)) c (e/g)²,        c = max |d²/du² (1 + u⁴)^(-1/2)|
/// ```
///
/// for an axle whose force is wanted ([`TyreLimits::coupling`](crate::vehicle::TyreLimits) is `(e/g)²`, with `e` of
/// [`SingleTrack`](crate::vehicle::SingleTrack)), so that `½ d_t (a_t - ā_t)²` about the previous plan's `ā_t` outweighs it,
/// as in majorisation (Hunter and Lange, *A tutorial on MM algorithms*, The American Statistician 58(1), 2004) and with convex
/// Hessians in sequential programming (Verschueren, van Duijkeren, Quirynen and Diehl, *Exploiting convexity in direct optimal
/// control: a sequential convex quadratic programming method*, CDC 2016). A descent is not guaranteed: `p_f` and `f(0)` are
/// those of the operating trajectory, `d_t` is limited, and axles whose force increases the cost are left out. The term
/// vanishes where the plan does not change, and where lateral force is not scarce: there the multipliers are small.
///
/// Multipliers are those of the cost and of the soft bounds along the operating trajectory, `p_t = ∇_x + A_tᵀ p_{t+1}`, but not
/// of the track's edges, whose penalty would hold the plan of a vehicle that has to come back from beyond one. The
/// force of each axle is its share of the lateral acceleration of a steady bend, `v_x omega`. Without a previous plan there
/// is no term.
pub(super) fn proximal(
    setup: &Setup,
    road: &Road,
    dynamics: &Linearisation,
    guess: &Guess,
    qp: &mut OcpQp,
) {
    let (vehicle, operating) = (setup.vehicle, &dynamics.x);
    let factor = setup.settings.cost.proximal;
    let known = factor > 0.0 && !guess.x.is_empty();
    let (l_f, l_r) = (vehicle.l_f, vehicle.l_r);
    let squared_gyration_radius = vehicle.yaw_inertia / vehicle.mass;
    let mut p = State::zeros();
    for t in (0..qp.horizon()).rev() {
        let (x, u) = (&operating[t], &guess.u[t]);
        let mut weight = 0.0;
        if known {
            p = qp.state_gradient(t, &operating[t + 1], &p);
            let lateral = -setup.dt * x[V_X] * x[OMEGA] / (l_f + l_r);
            let front = lateral * l_r * (p[V_Y] + p[OMEGA] * l_f / squared_gyration_radius);
            let rear = lateral * l_f * (p[V_Y] - p[OMEGA] * l_r / squared_gyration_radius);
            let [coupling_f, coupling_r] = road.tyres[t].coupling;
            let curvature =
                LARGEST_CURVATURE * (front.max(0.0) * coupling_f + rear.max(0.0) * coupling_r);
            weight = (factor * curvature).min(LARGEST_WEIGHT);
        }
        let stage = &mut qp.stages_mut()[t];
        stage.proximal = Input::new(weight, 0.0);
        stage.planned = Input::new(u[FORCE] / vehicle.mass, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curvature_of_the_force_that_is_left_is_bounded() {
        let left = |u: f64| (1.0 + u.powi(4)).powf(-0.5);
        let curvature = |u: f64| (left(u + 1e-3) - 2.0 * left(u) + left(u - 1e-3)).abs() * 1e6;
        let largest = (0..4000)
            .map(|i| curvature(1e-3 * f64::from(i)))
            .fold(0.0, f64::max);
        assert!(largest < LARGEST_CURVATURE);
        assert!(largest > 0.999 * LARGEST_CURVATURE, "{largest}");
    }
}
