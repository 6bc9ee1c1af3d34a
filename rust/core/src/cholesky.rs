//! Cholesky factor of a symmetric positive definite matrix, lower triangle packed row by row.
//!
//! Rows are contiguous, so that factoring and solving are dot products over memory in order; half the memory of a
//! full matrix, which matters with dozens of members of a thousand points.

use crate::simd::{Vectorised, vectorised};

/// `L` with `L Lᵀ = A`.
#[derive(Clone, Debug)]
pub(crate) struct Cholesky {
    rows: Vec<f64>,
}

/// The matrix is not positive definite; found at this row.
#[derive(Debug)]
pub(crate) struct NotPositiveDefinite(pub usize);

/// Rows factored together.
const PANEL: usize = 16;

/// Where row `i` of a packed lower triangle begins.
const fn row_start(i: usize) -> usize {
    i * (i + 1) / 2
}

impl Cholesky {
    /// Factors the `n × n` matrix with the given packed lower triangle (row `i` has `i + 1` entries) in place.
    pub fn factor(n: usize, mut lower: Vec<f64>) -> Result<Self, NotPositiveDefinite> {
        vectorised(Factor {
            n,
            lower: &mut lower,
        })?;
        Ok(Self { rows: lower })
    }

    /// Replaces `b` by `L⁻¹ b`.
    pub fn half_solve(&self, b: &mut [f64]) {
        vectorised(HalfSolve {
            rows: &self.rows,
            b,
        });
    }
}

/// [`Cholesky::factor`].
struct Factor<'a> {
    n: usize,
    lower: &'a mut [f64],
}

impl Vectorised for Factor<'_> {
    type Output = Result<(), NotPositiveDefinite>;

    #[inline(always)]
    fn compute(self) -> Self::Output {
        // Entry (i, j) needs the entries before it in rows i and j. Going down the columns of a panel of rows uses
        // each earlier row for the whole panel while it is in the cache.
        for start in (0..self.n).step_by(PANEL) {
            let end = self.n.min(start + PANEL);
            for j in 0..end {
                for i in start.max(j)..end {
                    let (above, row) = self.lower.split_at_mut(row_start(i));
                    if i == j {
                        let pivot = row[j] - dot(&row[..j], &row[..j]);
                        if pivot.is_nan() || pivot <= 0.0 {
                            return Err(NotPositiveDefinite(j));
                        }
                        row[j] = pivot.sqrt();
                    } else {
                        let row_j = &above[row_start(j)..=row_start(j) + j];
                        row[j] = (row[j] - dot(&row[..j], &row_j[..j])) / row_j[j];
                    }
                }
            }
        }
        Ok(())
    }
}

/// [`Cholesky::half_solve`].
struct HalfSolve<'a> {
    rows: &'a [f64],
    b: &'a mut [f64],
}

impl Vectorised for HalfSolve<'_> {
    type Output = ();

    #[inline(always)]
    fn compute(self) {
        let Self { rows, b } = self;
        for i in 0..b.len() {
            let row = &rows[row_start(i)..=row_start(i) + i];
            b[i] = (b[i] - dot(&row[..i], &b[..i])) / row[i];
        }
    }
}

/// Dot product in a fixed order of lanes: vectorised, and the same bits every time.
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let (a_blocks, a_rest) = a.as_chunks::<LANES>();
    let (b_blocks, b_rest) = b.as_chunks::<LANES>();
    let mut lanes = [0.0; LANES];
    for (a, b) in a_blocks.iter().zip(b_blocks) {
        for l in 0..LANES {
            lanes[l] = a[l].mul_add(b[l], lanes[l]);
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    lanes.iter().sum::<f64>() + rest
}
