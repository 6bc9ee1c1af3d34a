//! One stage of the problem and of the iterate.

use super::recursion::{Aug, Dynamics, Row, Symmetric};
use super::rows::{Bounds, Iterate};
use crate::NU;

/// One stage of the problem: from `s` at its start to `s⁺` at its end.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stage {
    pub dynamics: Dynamics,
    /// Affine term of the dynamics.
    pub offset: Row,
    /// Hessian of the cost of `s⁺`.
    pub hessian: Symmetric,
    /// Gradient of the cost of `s⁺` at zero.
    pub gradient: Aug,
    /// Diagonal weight of `v`.
    pub rate: [f64; NU],
    pub bounds: Bounds,
}

/// Primal-dual point of a stage.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Point {
    pub v: [f64; NU],
    /// `s⁺`.
    pub s: Aug,
    pub rows: Iterate,
}

/// `s⁺ = Ā s + B̄ v + c` along the horizon.
#[inline(always)]
pub(super) fn roll_out(initial: &Aug, stages: &[Stage], points: &mut [Point]) {
    let mut s = *initial;
    for (stage, point) in stages.iter().zip(points) {
        s = stage.successor(&s, &point.v);
        point.s = s;
    }
}

impl Stage {
    /// Gradient of the stage's own cost at `s⁺`.
    #[inline(always)]
    pub fn cost_gradient(&self, s: &Aug) -> Aug {
        let mut g = self.hessian.apply(s);
        g.add(&self.gradient);
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
