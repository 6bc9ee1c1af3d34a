//! Low-rank changes of the working set on a Riccati factorisation that is kept (Axehill & Hansson,
//! *A dual gradient projection quadratic programming algorithm tailored for model predictive control*, CDC 2008;
//! Arnström, Bemporad & Axehill, IEEE TAC 67, 2022).
//!
//! Let `H` be the Hessian in the controls with the curvature `d_k a_k a_kᵀ` of the working set that was factorised. If
//! the estimate of the multiplier of row `k` changes from `f_k(y)` to `f_k'(y)`, both affine with the derivatives `d_k` and
//! `d_k'`, and `τ_k` is the difference of both estimates at the new solution, the new row values are
//!
//! ```text
//! y' = y − Σ_j z_j τ_j,   z_j = A H⁻¹ a_jᵀ,
//! (1/δ_k) τ_k + Σ_j z_j[k] τ_j = (f_k'(y_k) − f_k(y_k)) / δ_k,   δ_k = d_k' − d_k.
//! ```
//!
//! A column `z_j` takes one backward and one forward sweep. The symmetric matrix of the last equation is kept as
//! `L D Lᵀ`; its pivots have the signs of `δ`, because every working set has a positive definite Hessian.

use super::stage::PAIRS;
use super::two_sided::Pairs;

/// Largest number of rows that differ from the factorised working set.
pub(super) const MAX_RANK: usize = 32;

/// A pivot vanishes if it is at most this share of the larger one of the two terms of which it is the sum, before the earlier
/// rows are subtracted: what is left is then rounding.
const VANISHING: f64 = 1e-14;

/// A row of the horizon: its stage and its place in the stage.
pub(super) type Place = (usize, usize);

/// A row whose multiplier estimate differs from that of the factorised working set.
#[derive(Clone, Copy, Debug, Default)]
struct Change {
    place: Place,
    /// Index of its column.
    column: usize,
    /// `1/δ`.
    inverse: f64,
    /// Right-hand side.
    rhs: f64,
}

/// The changed rows, their columns and the factorisation.
#[derive(Clone, Debug)]
pub(super) struct LowRank {
    horizon: usize,
    /// Columns `z`, one after the other; those of rows that changed back are kept.
    columns: Vec<Pairs>,
    places: Vec<Place>,
    changes: Vec<Change>,
    /// `L` by rows, without its unit diagonal.
    lower: Vec<[f64; MAX_RANK]>,
    diagonal: Vec<f64>,
    /// `τ`.
    differences: Vec<f64>,
}

impl LowRank {
    pub fn new(horizon: usize) -> Self {
        Self {
            horizon,
            columns: vec![[0.0; PAIRS]; horizon * MAX_RANK],
            places: Vec::with_capacity(MAX_RANK),
            changes: Vec::with_capacity(MAX_RANK),
            lower: vec![[0.0; MAX_RANK]; MAX_RANK],
            diagonal: vec![0.0; MAX_RANK],
            differences: Vec::with_capacity(MAX_RANK),
        }
    }

    /// Forgets all changes and columns; for a new factorisation.
    pub fn clear(&mut self) {
        self.places.clear();
        self.changes.clear();
        self.differences.clear();
    }

    /// The index of a row's column, if it was computed.
    #[inline(always)]
    pub fn find(&self, place: Place) -> Option<usize> {
        self.places.iter().position(|p| *p == place)
    }

    /// Memory for the column of a row and its index; none if [`MAX_RANK`] columns are in use.
    #[inline(always)]
    pub fn reserve(&mut self, place: Place) -> Option<(usize, &mut [Pairs])> {
        let index = self.places.len();
        if index == MAX_RANK {
            return None;
        }
        self.places.push(place);
        let start = index * self.horizon;
        Some((index, &mut self.columns[start..start + self.horizon]))
    }

    /// Sets the change of a row, whose column exists: `δ` is the difference of the derivatives, and `excess` that of the
    /// estimates at the row values of the factorisation. `δ = 0` takes a change back. False if a pivot vanishes.
    #[inline(always)]
    pub fn set(&mut self, column: usize, delta: f64, excess: f64) -> bool {
        let at = self.changes.iter().position(|c| c.column == column);
        let mut from = at.unwrap_or(self.changes.len());
        if delta == 0.0 {
            if at.is_some() {
                self.changes.remove(from);
            }
        } else {
            let change = Change {
                place: self.places[column],
                column,
                inverse: 1.0 / delta,
                rhs: excess / delta,
            };
            match at {
                Some(at) => self.changes[at] = change,
                None => self.changes.push(change),
            }
        }
        while from < self.changes.len() {
            if !self.factorise_row(from) {
                return false;
            }
            from += 1;
        }
        self.solve();
        true
    }

    /// Row `i` of the factorisation, from the rows before it.
    #[inline(always)]
    fn factorise_row(&mut self, i: usize) -> bool {
        let row = self.changes[i];
        let column = &self.columns[row.column * self.horizon..][..self.horizon];
        let mut own = row.inverse + column[row.place.0][row.place.1];
        let size = row
            .inverse
            .abs()
            .max(column[row.place.0][row.place.1].abs());
        let mut values = [0.0; MAX_RANK];
        for j in 0..i {
            let place = self.changes[j].place;
            let mut value = column[place.0][place.1];
            for l in 0..j {
                value -= self.lower[j][l] * values[l];
            }
            values[j] = value; // L[i][j] D[j]
        }
        for j in 0..i {
            let value = values[j];
            self.lower[i][j] = value / self.diagonal[j];
            own -= self.lower[i][j] * value;
        }
        self.diagonal[i] = own;
        own.abs() > VANISHING * size
    }

    /// `τ` from the factorisation.
    #[inline(always)]
    fn solve(&mut self) {
        let n = self.changes.len();
        self.differences.clear();
        for i in 0..n {
            let mut value = self.changes[i].rhs;
            for j in 0..i {
                value -= self.lower[i][j] * self.differences[j];
            }
            self.differences.push(value);
        }
        for i in 0..n {
            self.differences[i] /= self.diagonal[i];
        }
        for i in (0..n).rev() {
            let value = self.differences[i];
            for j in 0..i {
                self.differences[j] -= self.lower[i][j] * value;
            }
        }
    }

    /// The places of the changed rows with their `τ`.
    pub fn differences(&self) -> impl Iterator<Item = (Place, f64)> + '_ {
        self.changes
            .iter()
            .map(|c| c.place)
            .zip(self.differences.iter().copied())
    }

    /// Adds `−Σ z_j τ_j` at stage `t`.
    #[inline(always)]
    pub fn shift(&self, t: usize, y: &mut Pairs) {
        for (change, difference) in self.changes.iter().zip(&self.differences) {
            let column = &self.columns[change.column * self.horizon + t];
            for k in 0..PAIRS {
                y[k] = column[k].mul_add(-difference, y[k]);
            }
        }
    }
}
