//! One stage of the problem and the order of its inequality rows.

use super::recursion::{Aug, Curvature, Dynamics, LANES, Row};
use super::two_sided::TwoSided;
use crate::vehicle::{DELTA, OMEGA, P_X, P_Y, V_X, V_Y};
use crate::{NU, NX};

/// One stage of the problem: from `s` at its start to `s⁺` at its end.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stage {
    pub dynamics: Dynamics,
    /// Affine term of the dynamics.
    pub offset: Row,
    /// Curvature of the cost of `s⁺`.
    pub cost: Curvature,
    /// Gradient of the cost of `s⁺` at zero.
    pub gradient: Row,
    /// Its input part.
    pub input_gradient: [f64; NU],
    /// Diagonal weight of `v`.
    pub rate: [f64; NU],
    pub rows: TwoSided,
}

/// Two-sided rows of a stage: rate (2), input (2), v_x, delta, v_y, omega, track, padding (3).
pub(super) const PAIRS: usize = 12;
/// First input row; rate rows come before it.
pub(super) const INPUT: usize = NU;
/// First box row on a state.
pub(super) const STATE: usize = 2 * NU;
/// The states that may be boxed, in the order of their rows: v_x, delta, v_y, omega.
const BOXED: [usize; 4] = [V_X, DELTA, V_Y, OMEGA];
/// The track row.
pub(super) const TRACK: usize = STATE + BOXED.len();

/// The value `a·w` of each two-sided row, where `w = (v, s⁺)`.
#[inline(always)]
pub(super) fn row_values(v: &[f64; NU], s: &Aug, normal: &[f64; 2]) -> [f64; PAIRS] {
    let track = normal[0].mul_add(s.x[P_X], normal[1] * s.x[P_Y]);
    let [v_x, delta, v_y, omega] = BOXED.map(|i| s.x[i]);
    [
        v[0], v[1], s.u[0], s.u[1], v_x, delta, v_y, omega, track, 0.0, 0.0, 0.0,
    ]
}

/// Hessian `Σ weight a aᵀ` of the rows on `s⁺`. The Hessian of the rate rows is their weight itself.
#[inline(always)]
pub(super) fn row_curvature(weight: &[f64; PAIRS], normal: &[f64; 2]) -> Curvature {
    let (n_x, n_y) = (weight[TRACK] * normal[0], weight[TRACK] * normal[1]);
    Curvature {
        x: on_states([n_x * normal[0], n_y * normal[1]], weight),
        cross: n_x * normal[1],
        u: [weight[INPUT], weight[INPUT + 1]],
    }
}

/// Gradient `Σ λ a` of the rows on `s⁺`. The gradient of the rate rows is their multiplier itself.
#[inline(always)]
pub(super) fn row_gradient(lambda: &[f64; PAIRS], normal: &[f64; 2]) -> Aug {
    let track = lambda[TRACK];
    Aug {
        x: on_states([track * normal[0], track * normal[1]], lambda),
        u: [lambda[INPUT], lambda[INPUT + 1]],
    }
}

/// A state row with the values of the track row at the position, and those of the box rows at their states.
#[inline(always)]
fn on_states(position: [f64; 2], rows: &[f64; PAIRS]) -> Row {
    let mut x = [0.0; LANES];
    (x[P_X], x[P_Y]) = (position[0], position[1]);
    for (k, i) in BOXED.into_iter().enumerate() {
        x[i] = rows[STATE + k];
    }
    x
}

impl Stage {
    /// Gradient of the stage's own cost at `s⁺`.
    #[inline(always)]
    pub fn cost_gradient(&self, s: &Aug) -> Aug {
        let mut g = self.cost.apply(s);
        for i in 0..NX {
            g.x[i] += self.gradient[i];
        }
        for i in 0..NU {
            g.u[i] += self.input_gradient[i];
        }
        g
    }

    /// `s⁺ = Ā s + B̄ v + c`.
    #[inline(always)]
    pub fn successor(&self, s: &Aug, v: &[f64; NU]) -> Aug {
        let u = [s.u[0] + v[0], s.u[1] + v[1]];
        let mut x = self.dynamics.apply(&s.x, &u);
        for (x, c) in x.iter_mut().zip(&self.offset) {
            *x += c;
        }
        Aug { x, u }
    }
}
