//! Stage-wise Riccati recursion on the rate-augmented problem.
//!
//! With `s = [x, u₋]` (the state and the input applied before the stage) and the control
//! `v = u − u₋`, a linear time-varying OCP with input-rate terms is a plain LQ problem:
//!
//! ```text
//! s⁺ = Ā s + B̄ v,   Ā = [A B; 0 I],   B̄ = [B; I] = the last NU columns of Ā
//! min Σ ½ vᵀ D v + gᵥᵀ v  +  Σ ½ sᵀ H s + gₛᵀ s
//! ```
//!
//! so the product `M = Āᵀ P Ā` contains all three blocks that the recursion needs:
//! `Q_ss = M`, `Q_vs = M[u, :]`, `Q_vv = D + M[u, u]` (Rawlings, Mayne, Diehl, *Model Predictive
//! Control*, 2nd ed., section 8.8). The bottom rows of `Ā` are never stored.
//!
//! State rows are padded with zeros to `LANES`, so that a row fills whole vector registers.

use crate::cholesky::axpy;
use crate::{NU, NX};

/// A state row padded to whole vector registers.
pub(super) const LANES: usize = 8;
/// Rows of the augmented state `[x, u₋]`.
pub(super) const NS: usize = NX + NU;
pub(super) type Row = [f64; LANES];

/// Inner product of two padded rows, in a fixed order of summation.
#[inline(always)]
pub(super) fn dot(a: &Row, b: &Row) -> f64 {
    let mut p = [0.0; LANES];
    for i in 0..LANES {
        p[i] = a[i] * b[i];
    }
    ((p[0] + p[4]) + (p[2] + p[6])) + ((p[1] + p[5]) + (p[3] + p[7]))
}

/// `Σ values[i] · rows[i]` over the given `i`.
#[inline(always)]
fn combine<const N: usize, const M: usize>(rows: &[Row; M], values: &Row, over: [usize; N]) -> Row {
    let mut out = [0.0; LANES];
    for i in over {
        axpy(&mut out, values[i], &rows[i]);
    }
    out
}

/// `[A B]` of one stage, by columns for products and by rows for transposed products. Both have the zeros of
/// [`crate::qp::A_PATTERN`] and [`crate::qp::B_PATTERN`], which halves the work of a factorisation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Dynamics {
    /// Columns of `[A B]`.
    pub columns: [Row; NS],
    /// Rows of `A`.
    pub a_rows: [Row; NX],
}

impl Dynamics {
    /// `Ā [x; u] = [A x + B u; u]`, the state part.
    #[inline(always)]
    pub fn apply(&self, x: &Row, u: &[f64; NU]) -> Row {
        let mut out = [0.0; LANES];
        for (column, value) in self.columns.iter().zip(x.iter().take(NX).chain(u)) {
            axpy(&mut out, *value, column);
        }
        out
    }

    /// `Āᵀ [q; r] = [Aᵀ q; Bᵀ q + r]`.
    #[inline(always)]
    pub fn apply_transposed(&self, q: &Aug) -> Aug {
        let mut x = [0.0; LANES];
        for (row, value) in self.a_rows.iter().zip(&q.x) {
            axpy(&mut x, *value, row);
        }
        let b = self.input_products(&q.x);
        Aug {
            x,
            u: [q.u[0] + b[0], q.u[1] + b[1]],
        }
    }

    /// `Bᵀ q`.
    #[inline(always)]
    fn input_products(&self, q: &Row) -> [f64; NU] {
        let [.., force, rate] = &self.columns;
        [
            force[2].mul_add(q[2], force[4].mul_add(q[4], force[5] * q[5])),
            rate[2].mul_add(q[2], rate[4] * q[4]) + rate[5].mul_add(q[5], rate[6] * q[6]),
        ]
    }

    /// `M [A B]` for a symmetric `M`, by columns.
    #[inline(always)]
    fn times(&self, m: &[Row; NX]) -> [Row; NS] {
        let c = &self.columns;
        [
            combine(m, &c[0], [0]),
            combine(m, &c[1], [1]),
            combine(m, &c[2], [0, 1, 2, 4, 5]),
            combine(m, &c[3], [0, 1, 3]),
            combine(m, &c[4], [0, 1, 2, 4, 5]),
            combine(m, &c[5], [0, 1, 2, 3, 4, 5]),
            combine(m, &c[6], [2, 4, 5, 6]),
            combine(m, &c[7], [2, 4, 5]),
            combine(m, &c[8], [2, 4, 5, 6]),
        ]
    }
}

/// A vector over the augmented state `[x, u]`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Aug {
    pub x: Row,
    pub u: [f64; NU],
}

impl Aug {
    /// `self += other`.
    #[inline(always)]
    pub fn add(&mut self, other: &Self) {
        let mine = self.x.iter_mut().chain(&mut self.u);
        for (m, o) in mine.zip(other.x.iter().chain(&other.u)) {
            *m += o;
        }
    }

    /// `self − other`.
    #[inline(always)]
    pub fn minus(&self, other: &Self) -> Self {
        let mut out = *self;
        for i in 0..LANES {
            out.x[i] -= other.x[i];
        }
        for i in 0..NU {
            out.u[i] -= other.u[i];
        }
        out
    }
}

/// A symmetric matrix over the augmented state: `[xx, xu; xuᵀ, uu]`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Symmetric {
    /// Columns of the state block.
    pub xx: [Row; NX],
    /// Columns of the state-input block.
    pub xu: [Row; NU],
    pub uu: [[f64; NU]; NU],
}

impl Symmetric {
    /// Adds the Hessian of a stage.
    #[inline(always)]
    pub fn add(&mut self, cost: &Curvature) {
        for (i, column) in self.xx.iter_mut().enumerate() {
            column[i] += cost.x[i];
        }
        self.xx[0][1] += cost.cross;
        self.xx[1][0] += cost.cross;
        for i in 0..NU {
            self.uu[i][i] += cost.u[i];
        }
    }
}

/// Hessian of a stage's cost or of its rows: a diagonal and the cross term of the position.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Curvature {
    pub x: Row,
    pub cross: f64,
    pub u: [f64; NU],
}

impl Curvature {
    /// Product with an augmented vector.
    #[inline(always)]
    pub fn apply(&self, s: &Aug) -> Aug {
        let mut x = [0.0; LANES];
        for i in 0..LANES {
            x[i] = self.x[i] * s.x[i];
        }
        x[0] = self.cross.mul_add(s.x[1], x[0]);
        x[1] = self.cross.mul_add(s.x[0], x[1]);
        Aug {
            x,
            u: [self.u[0] * s.u[0], self.u[1] * s.u[1]],
        }
    }
}

/// Factors of one stage: `Q_vv = L Lᵀ` and `Y = L⁻¹ Q_vs`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Factor {
    /// Reciprocal diagonal of `L`.
    inverse_diagonal: [f64; NU],
    /// The entry of `L` below its diagonal.
    below: f64,
    y_x: [Row; NU],
    y_u: [[f64; NU]; NU],
}

impl Factor {
    /// The factors for `M`, with `rate` on the diagonal of `Q_vv`; `None` if that is not positive definite.
    #[inline(always)]
    fn of(m: &Symmetric, rate: &[f64; NU]) -> Option<Self> {
        let cross = m.uu[0][1];
        let first = m.uu[0][0] + rate[0];
        let d0 = 1.0 / first.sqrt();
        let below = cross * d0;
        let second = below.mul_add(-below, m.uu[1][1] + rate[1]);
        if !(first > 0.0 && second > 0.0) {
            return None;
        }
        let d1 = 1.0 / second.sqrt();
        let mut factor = Self {
            inverse_diagonal: [d0, d1],
            below,
            ..Self::default()
        };
        for i in 0..LANES {
            let y = factor.forward([m.xu[0][i], m.xu[1][i]]);
            factor.y_x[0][i] = y[0];
            factor.y_x[1][i] = y[1];
        }
        for j in 0..NU {
            let y = factor.forward([m.uu[0][j], m.uu[1][j]]);
            factor.y_u[0][j] = y[0];
            factor.y_u[1][j] = y[1];
        }
        Some(factor)
    }

    /// `L⁻¹ q`.
    #[inline(always)]
    fn forward(&self, q: [f64; NU]) -> [f64; NU] {
        let a = q[0] * self.inverse_diagonal[0];
        [a, (q[1] - self.below * a) * self.inverse_diagonal[1]]
    }

    /// `L⁻ᵀ q`.
    #[inline(always)]
    fn backward(&self, q: [f64; NU]) -> [f64; NU] {
        let b = q[1] * self.inverse_diagonal[1];
        [(q[0] - self.below * b) * self.inverse_diagonal[0], b]
    }
}

/// One stage of the backward sweep: factorises `Q_vv` and returns the `P` of the previous stage, to which the caller
/// adds that stage's Hessian. `None` if `Q_vv` is not positive definite to working precision.
#[inline(always)]
pub(super) fn factorise(
    dynamics: &Dynamics,
    rate: &[f64; NU],
    p: &Symmetric,
) -> Option<(Factor, Symmetric)> {
    let mut m = congruence(dynamics, p);
    let factor = Factor::of(&m, rate)?;
    // P = M − Yᵀ Y.
    for k in 0..NU {
        for (j, column) in m.xx.iter_mut().enumerate() {
            axpy(column, -factor.y_x[k][j], &factor.y_x[k]);
        }
        for (j, column) in m.xu.iter_mut().enumerate() {
            axpy(column, -factor.y_u[k][j], &factor.y_x[k]);
        }
        for i in 0..NU {
            for j in 0..NU {
                m.uu[i][j] = factor.y_u[k][i].mul_add(-factor.y_u[k][j], m.uu[i][j]);
            }
        }
    }
    Some((factor, m))
}

/// `M = Āᵀ P Ā`.
#[inline(always)]
fn congruence(dynamics: &Dynamics, p: &Symmetric) -> Symmetric {
    // G = P Ā restricted to its state rows: [Pxx A, Pxx B + Pxu].
    let mut g = dynamics.times(&p.xx);
    for (g, p_column) in g[NX..].iter_mut().zip(&p.xu) {
        for (g, p) in g.iter_mut().zip(p_column) {
            *g += p;
        }
    }
    let column = |g: &Row| combine(&dynamics.a_rows, g, [0, 1, 2, 3, 4, 5, 6]);
    let [x0, x1, x2, x3, x4, x5, x6, u0, u1] = &g;
    let mut m = Symmetric {
        xx: [
            column(x0),
            column(x1),
            column(x2),
            column(x3),
            column(x4),
            column(x5),
            column(x6),
        ],
        xu: [column(u0), column(u1)],
        uu: [[0.0; NU]; NU],
    };
    for i in 0..NU {
        // Bᵀ G + (Bᵀ Pxu)ᵀ + Puu, one column at a time.
        let (down, across) = (
            dynamics.input_products(&g[NX + i]),
            dynamics.input_products(&p.xu[i]),
        );
        for j in 0..NU {
            m.uu[i][j] += down[j] + p.uu[i][j];
            m.uu[j][i] += across[j];
        }
    }
    let cross = 0.5 * (m.uu[0][1] + m.uu[1][0]);
    m.uu[0][1] = cross;
    m.uu[1][0] = cross;
    m
}

/// One stage of the backward sweep for a right-hand side: from the gradient of the cost-to-go after the stage to the
/// gradient before it (without `gₛ` of the previous stage), and the feedforward term `L⁻¹ q_v` of the forward sweep.
#[inline(always)]
pub(super) fn backward(
    dynamics: &Dynamics,
    factor: &Factor,
    next: &Aug,
    g_v: &[f64; NU],
) -> (Aug, [f64; NU]) {
    let mut p = dynamics.apply_transposed(next);
    let y = factor.forward([g_v[0] + p.u[0], g_v[1] + p.u[1]]);
    for k in 0..NU {
        axpy(&mut p.x, -y[k], &factor.y_x[k]);
        for j in 0..NU {
            p.u[j] = factor.y_u[k][j].mul_add(-y[k], p.u[j]);
        }
    }
    (p, y)
}

/// One stage of the forward sweep: the control `v` and the next augmented state.
#[inline(always)]
pub(super) fn forward(
    dynamics: &Dynamics,
    factor: &Factor,
    y: &[f64; NU],
    s: &Aug,
) -> ([f64; NU], Aug) {
    let mut t = *y;
    for k in 0..NU {
        t[k] += dot(&factor.y_x[k], &s.x);
        for j in 0..NU {
            t[k] = factor.y_u[k][j].mul_add(s.u[j], t[k]);
        }
    }
    let v = factor.backward([-t[0], -t[1]]);
    let u = [s.u[0] + v[0], s.u[1] + v[1]];
    (
        v,
        Aug {
            x: dynamics.apply(&s.x, &u),
            u,
        },
    )
}
