//! An [`OcpQp`] as one sparse QP: `min ½ zᵀPz + qᵀz` subject to `l <= Az <= u`.
//!
//! The variables of stage `t` are `[u_t, e_{t+1}, s_{t+1}]` with `e = x - r`. With deviations from the reference the
//! objective is the tracking cost without a large constant, which relative tolerances require. The pattern is fixed at
//! construction; [`SparseQp::update`] replaces values in place.

use super::{A_PATTERN, B_PATTERN, OcpQp, OcpSolution, Q_PATTERN, SOFT_PATTERN};
use crate::{Input, NU, NX};

/// A matrix in compressed sparse columns with sorted rows.
#[derive(Debug, Clone, PartialEq)]
pub struct Csc {
    /// Number of rows.
    pub rows: usize,
    /// Number of columns.
    pub columns: usize,
    /// Start of each column in `row_index` and `values`, `columns + 1` entries.
    pub column_start: Vec<usize>,
    /// Row of each entry.
    pub row_index: Vec<usize>,
    /// Value of each entry.
    pub values: Vec<f64>,
}

impl Csc {
    /// The pattern of `entries` (row, column), and the index of each entry in `values`.
    pub(crate) fn from_entries(
        rows: usize,
        columns: usize,
        entries: &[(usize, usize)],
    ) -> (Self, Vec<usize>) {
        let mut order: Vec<usize> = (0..entries.len()).collect();
        order.sort_by_key(|&k| (entries[k].1, entries[k].0));
        let mut slots = vec![0; entries.len()];
        let mut column_start = vec![0; columns + 1];
        for (slot, &k) in order.iter().enumerate() {
            slots[k] = slot;
            column_start[entries[k].1 + 1] += 1;
        }
        for column in 0..columns {
            column_start[column + 1] += column_start[column];
        }
        let row_index = order.iter().map(|&k| entries[k].0).collect();
        (
            Self {
                rows,
                columns,
                column_start,
                row_index,
                values: vec![0.0; entries.len()],
            },
            slots,
        )
    }
}

/// An [`OcpQp`] as a sparse QP.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseQp {
    /// Upper triangle of `P`.
    pub p: Csc,
    /// Linear cost.
    pub q: Vec<f64>,
    /// Constraint matrix.
    pub a: Csc,
    /// Lower bounds, `-∞` for none; which bounds are infinite is part of the pattern.
    pub l: Vec<f64>,
    /// Upper bounds, `∞` for none.
    pub u: Vec<f64>,
    p_slots: Vec<usize>,
    a_slots: Vec<usize>,
    layout: Layout,
}

/// Indices of the variables and rows of a stage.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Layout {
    n_soft: usize,
}

impl Layout {
    fn variables(self) -> usize {
        NU + NX + self.n_soft
    }
    fn rows(self) -> usize {
        NX + 2 * NU + 3 * self.n_soft
    }
    /// Column of `u_t[i]`.
    fn input(self, t: usize, i: usize) -> usize {
        t * self.variables() + i
    }
    /// Column of `e_{t+1}[i]`.
    fn state(self, t: usize, i: usize) -> usize {
        t * self.variables() + NU + i
    }
    /// Column of `s_{t+1}[j]`.
    fn slack(self, t: usize, j: usize) -> usize {
        t * self.variables() + NU + NX + j
    }
    /// Row of component `i` of transition `t`.
    fn dynamics_row(self, t: usize, i: usize) -> usize {
        t * self.rows() + i
    }
    /// Row of the bound on `u_t[i]`.
    fn input_row(self, t: usize, i: usize) -> usize {
        t * self.rows() + NX + i
    }
    /// Row of the bound on `u_t[i] - u_{t-1}[i]`.
    fn rate_row(self, t: usize, i: usize) -> usize {
        t * self.rows() + NX + NU + i
    }
    /// Rows of soft bound `j` of `x_{t+1}`: lower, upper, slack.
    fn soft_row(self, t: usize, j: usize, side: usize) -> usize {
        t * self.rows() + NX + 2 * NU + 3 * j + side
    }
}

impl SparseQp {
    /// The pattern of `qp`, with its values.
    pub fn new(qp: &OcpQp) -> Self {
        let layout = Layout {
            n_soft: qp.n_soft(),
        };
        let (n, m) = (
            qp.horizon() * layout.variables(),
            qp.horizon() * layout.rows(),
        );
        let mut entries = Vec::new();
        quadratic(qp, layout, |row, column, _| entries.push((row, column)));
        let (p, p_slots) = Csc::from_entries(n, n, &entries);
        entries.clear();
        constraints(qp, layout, |row, column, _| entries.push((row, column)));
        let (a, a_slots) = Csc::from_entries(m, n, &entries);
        let mut sparse = Self {
            p,
            q: vec![0.0; n],
            a,
            l: vec![0.0; m],
            u: vec![0.0; m],
            p_slots,
            a_slots,
            layout,
        };
        sparse.update(qp);
        sparse
    }

    /// Copies the values of `qp`, which must have the horizon and number of soft rows given at construction.
    pub fn update(&mut self, qp: &OcpQp) {
        let (values, mut slots) = (&mut self.p.values, self.p_slots.iter());
        quadratic(qp, self.layout, |_, _, value| {
            if let Some(&slot) = slots.next() {
                values[slot] = value;
            }
        });
        let (values, mut slots) = (&mut self.a.values, self.a_slots.iter());
        constraints(qp, self.layout, |_, _, value| {
            if let Some(&slot) = slots.next() {
                values[slot] = value;
            }
        });
        self.update_vectors(qp);
    }

    /// Writes inputs and multipliers of a solution `z` to `out`. `multiplier(row, side)` is the multiplier, at least 0, of the
    /// lower bound (side 0) or the upper bound (side 1) of a row of `A`.
    pub(crate) fn read(
        &self,
        z: &[f64],
        multiplier: impl Fn(usize, usize) -> f64,
        out: &mut OcpSolution,
    ) {
        let layout = self.layout;
        for (t, (u, multipliers)) in out.u.iter_mut().zip(&mut out.multipliers).enumerate() {
            for i in 0..NU {
                u[i] = z[layout.input(t, i)];
                multipliers.u_lower[i] = multiplier(layout.input_row(t, i), 0);
                multipliers.u_upper[i] = multiplier(layout.input_row(t, i), 1);
                multipliers.du_lower[i] = multiplier(layout.rate_row(t, i), 0);
                multipliers.du_upper[i] = multiplier(layout.rate_row(t, i), 1);
            }
            for j in 0..layout.n_soft {
                multipliers.soft_lower[j] = multiplier(layout.soft_row(t, j, 0), 0);
                multipliers.soft_upper[j] = multiplier(layout.soft_row(t, j, 1), 1);
            }
        }
    }

    fn update_vectors(&mut self, qp: &OcpQp) {
        let layout = self.layout;
        for (t, stage) in qp.stages().iter().enumerate() {
            let origin = t
                .checked_sub(1)
                .map_or(&qp.x0, |before| &qp.stages()[before].reference);
            let offset = stage.a * origin + stage.c - stage.reference;
            for i in 0..NX {
                self.l[layout.dynamics_row(t, i)] = offset[i];
                self.u[layout.dynamics_row(t, i)] = offset[i];
            }
            let before = if t == 0 { qp.u_prev } else { Input::zeros() };
            for i in 0..NU {
                self.q[layout.input(t, i)] =
                    -qp.r_d[i] * before[i] - stage.proximal[i] * stage.planned[i];
                self.l[layout.input_row(t, i)] = stage.u_min[i];
                self.u[layout.input_row(t, i)] = stage.u_max[i];
                self.l[layout.rate_row(t, i)] = stage.du_min[i] + before[i];
                self.u[layout.rate_row(t, i)] = stage.du_max[i] + before[i];
            }
            for (j, row) in stage.soft[..qp.n_soft()].iter().enumerate() {
                let shift = row.normal.dot(&stage.reference);
                self.q[layout.slack(t, j)] = qp.penalty[j].linear;
                let bounds = [
                    (row.lower - shift, f64::INFINITY),
                    (f64::NEG_INFINITY, row.upper - shift),
                    (0.0, f64::INFINITY),
                ];
                for (side, (lower, upper)) in bounds.into_iter().enumerate() {
                    self.l[layout.soft_row(t, j, side)] = lower;
                    self.u[layout.soft_row(t, j, side)] = upper;
                }
            }
        }
    }
}

/// Emits the upper triangle of `P`, always the same entries in the same order.
fn quadratic(qp: &OcpQp, layout: Layout, mut emit: impl FnMut(usize, usize, f64)) {
    let last = qp.horizon().saturating_sub(1);
    for (t, stage) in qp.stages().iter().enumerate() {
        for i in 0..NU {
            let neighbours = if t == last { 1.0 } else { 2.0 };
            emit(
                layout.input(t, i),
                layout.input(t, i),
                qp.r[i] + stage.proximal[i] + neighbours * qp.r_d[i],
            );
            if t > 0 {
                emit(layout.input(t - 1, i), layout.input(t, i), -qp.r_d[i]);
            }
        }
        for (i, j) in Q_PATTERN {
            emit(layout.state(t, i), layout.state(t, j), stage.q[(i, j)]);
        }
        for j in 0..qp.n_soft() {
            emit(
                layout.slack(t, j),
                layout.slack(t, j),
                qp.penalty[j].quadratic,
            );
        }
    }
}

/// Emits `A`, always the same entries in the same order.
fn constraints(qp: &OcpQp, layout: Layout, mut emit: impl FnMut(usize, usize, f64)) {
    for (t, stage) in qp.stages().iter().enumerate() {
        for i in 0..NX {
            let row = layout.dynamics_row(t, i);
            emit(row, layout.state(t, i), 1.0);
            for &j in B_PATTERN[i] {
                emit(row, layout.input(t, j), -stage.b[(i, j)]);
            }
            if t > 0 {
                for &j in A_PATTERN[i] {
                    emit(row, layout.state(t - 1, j), -stage.a[(i, j)]);
                }
            }
        }
        for i in 0..NU {
            emit(layout.input_row(t, i), layout.input(t, i), 1.0);
            emit(layout.rate_row(t, i), layout.input(t, i), 1.0);
            if t > 0 {
                emit(layout.rate_row(t, i), layout.input(t - 1, i), -1.0);
            }
        }
        for (j, row) in stage.soft[..qp.n_soft()].iter().enumerate() {
            for (side, sign) in [(0, 1.0), (1, -1.0)] {
                for &i in SOFT_PATTERN[j] {
                    emit(
                        layout.soft_row(t, j, side),
                        layout.state(t, i),
                        row.normal[i],
                    );
                }
                emit(layout.soft_row(t, j, side), layout.slack(t, j), sign);
            }
            emit(layout.soft_row(t, j, 2), layout.slack(t, j), 1.0);
        }
    }
}
