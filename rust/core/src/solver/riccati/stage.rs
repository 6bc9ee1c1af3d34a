//! One stage of the problem and the order of its inequality rows.

use super::recursion::{Aug, Curvature, Dynamics, Row};
use super::two_sided::TwoSided;
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
pub(super) const BOXED: [usize; 4] = [2, 6, 4, 5];
/// The track row.
pub(super) const TRACK: usize = STATE + BOXED.len();

/// The value `a·w` of each two-sided row, where `w = (v, s⁺)`.
#[inline(always)]
pub(super) fn row_values(v: &[f64; NU], s: &Aug, normal: &[f64; 2]) -> [f64; PAIRS] {
    let track = normal[0].mul_add(s.x[0], normal[1] * s.x[1]);
    [
        v[0], v[1], s.u[0], s.u[1], s.x[2], s.x[6], s.x[4], s.x[5], track, 0.0, 0.0, 0.0,
    ]
}

/// Hessian `Σ weight a aᵀ` of the rows on `s⁺`. The Hessian of the rate rows is their weight itself.
#[inline(always)]
pub(super) fn row_curvature(weight: &[f64; PAIRS], normal: &[f64; 2]) -> Curvature {
    let (track, w) = (weight[TRACK], weight);
    let (nx, ny) = (track * normal[0], track * normal[1]);
    Curvature {
        x: [
            nx * normal[0],
            ny * normal[1],
            w[4],
            0.0,
            w[6],
            w[7],
            w[5],
            0.0,
        ],
        cross: nx * normal[1],
        u: [w[INPUT], w[INPUT + 1]],
    }
}

/// Gradient `Σ λ a` of the rows on `s⁺`. The gradient of the rate rows is their multiplier itself.
#[inline(always)]
pub(super) fn row_gradient(lambda: &[f64; PAIRS], normal: &[f64; 2]) -> Aug {
    let (track, l) = (lambda[TRACK], lambda);
    Aug {
        x: [
            track * normal[0],
            track * normal[1],
            l[4],
            0.0,
            l[6],
            l[7],
            l[5],
            0.0,
        ],
        u: [l[INPUT], l[INPUT + 1]],
    }
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
