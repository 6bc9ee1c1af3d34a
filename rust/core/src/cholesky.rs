//! Inverse Cholesky factor of a symmetric positive definite matrix.
//!
//! The inverse is stored instead of the factor because a row of a product does not depend on earlier rows, so that the
//! processor need not wait for them, and because several right-hand sides share one pass over the memory.

use crate::kernel::{LANES, Lanes};
use crate::simd::{Simd, Vectorised, Wide, vectorised_loops, wide};

/// `L⁻¹` with `L Lᵀ = A`.
///
/// Stored in panels of eight rows, column by column up to the diagonal: half the memory of a full matrix, in the order
/// of access. Padding rows and columns are zero.
#[derive(Clone, Debug)]
pub(crate) struct InverseFactor {
    panels: Vec<[Lanes; LANES]>,
    rows: usize,
}

/// The matrix is not positive definite to working precision; the row at which the factorisation failed.
#[derive(Debug)]
pub(crate) struct NotPositiveDefinite(pub usize);

/// Rows factored together.
const PANEL: usize = 16;

/// Start of row `i` in a packed lower triangle.
const fn row_start(i: usize) -> usize {
    i * (i + 1) / 2
}

impl InverseFactor {
    /// Factors the `n × n` matrix with the given packed lower triangle (row `i` has `i + 1` entries) and inverts the
    /// factor.
    pub fn new(n: usize, mut lower: Vec<f64>) -> Result<Self, NotPositiveDefinite> {
        vectorised_loops(Factor {
            n,
            lower: &mut lower,
        })?;
        vectorised_loops(Invert {
            n,
            lower: &mut lower,
        });
        let mut panels = Vec::with_capacity(row_start(n.div_ceil(LANES)));
        for start in (0..n).step_by(LANES) {
            let entry = |i: usize, j: usize| {
                let inside = i < n && j <= i;
                if inside { lower[row_start(i) + j] } else { 0.0 }
            };
            let column = |j| std::array::from_fn(|l| entry(start + l, j));
            let blocks = (0..=start).step_by(LANES);
            panels
                .extend(blocks.map(|j| std::array::from_fn::<Lanes, LANES, _>(|l| column(j + l))));
        }
        Ok(Self { panels, rows: n })
    }

    /// `L⁻¹ B` in one pass over the factor. The columns of `B` and of the product lie one after the other, each as long
    /// as the number of rows in blocks. The padding of `B` may hold any finite numbers.
    pub fn products(&self, b: &[Lanes], out: &mut [Lanes]) {
        debug_assert_eq!(b.len(), out.len());
        wide(Products {
            panels: &self.panels,
            blocks: self.rows.div_ceil(LANES),
            b,
            out,
        });
    }
}

/// The Cholesky factor in place.
struct Factor<'a> {
    n: usize,
    lower: &'a mut [f64],
}

impl Vectorised for Factor<'_> {
    type Output = Result<(), NotPositiveDefinite>;

    #[inline(always)]
    fn compute(self) -> Self::Output {
        // Entry (i, j) needs the entries before it in rows i and j. Proceeding by columns within a panel of rows uses
        // each earlier row for the whole panel while it is in the cache.
        for start in (0..self.n).step_by(PANEL) {
            let end = self.n.min(start + PANEL);
            for j in 0..end {
                for i in start.max(j)..end {
                    let (above, row) = self.lower.split_at_mut(row_start(i));
                    if i == j {
                        let pivot = row[j] - sum_of_products(&row[..j], &row[..j]);
                        // A pivot below the rounding error of the diagonal is zero.
                        if pivot.is_nan() || pivot <= self.n as f64 * f64::EPSILON * row[j] {
                            return Err(NotPositiveDefinite(j));
                        }
                        row[j] = pivot.sqrt();
                    } else {
                        let row_j = &above[row_start(j)..=row_start(j) + j];
                        row[j] = (row[j] - sum_of_products(&row[..j], &row_j[..j])) / row_j[j];
                    }
                }
            }
        }
        Ok(())
    }
}

/// The inverse of a lower triangle in place.
struct Invert<'a> {
    n: usize,
    lower: &'a mut [f64],
}

impl Vectorised for Invert<'_> {
    type Output = ();

    #[inline(always)]
    fn compute(self) {
        // Row i of the inverse is -1/L_ii times the sum of L_ik times row k of the inverse, k < i. Each earlier row
        // is used for a whole panel of rows while it is in the cache.
        let mut factor = vec![0.0; PANEL * self.n];
        for start in (0..self.n).step_by(PANEL) {
            let end = self.n.min(start + PANEL);
            for (i, copy) in (start..end).zip(factor.chunks_mut(self.n)) {
                let row = &mut self.lower[row_start(i)..=row_start(i) + i];
                copy[..=i].copy_from_slice(row);
                row.fill(0.0);
            }
            for k in 0..end {
                for i in start.max(k)..end {
                    let l = &factor[(i - start) * self.n..];
                    let (above, row) = self.lower.split_at_mut(row_start(i));
                    if i == k {
                        let inverse = 1.0 / l[i];
                        row[..i].iter_mut().for_each(|entry| *entry *= -inverse);
                        row[i] = inverse;
                    } else {
                        let earlier = &above[row_start(k)..=row_start(k) + k];
                        for (entry, earlier) in row[..=k].iter_mut().zip(earlier) {
                            *entry = l[k].mul_add(*earlier, *entry);
                        }
                    }
                }
            }
        }
    }
}

/// [`InverseFactor::products`].
struct Products<'a> {
    panels: &'a [[Lanes; LANES]],
    blocks: usize,
    b: &'a [Lanes],
    out: &'a mut [Lanes],
}

impl Products<'_> {
    /// Row block `p` of the product for columns `first` to `first + Q`. With `N` sums for each column, `N · Q` chains of
    /// additions run at once.
    #[inline(always)]
    fn tile<S: Simd, const Q: usize, const N: usize>(
        &mut self,
        simd: S,
        panel: &[[Lanes; LANES]],
        first: usize,
    ) {
        let columns: [&[Lanes]; Q] =
            std::array::from_fn(|q| &self.b[(first + q) * self.blocks..][..panel.len()]);
        let mut sums = [[simd.splat(0.0); Q]; N];
        for (j, block) in panel.iter().enumerate() {
            let b: [&Lanes; Q] = std::array::from_fn(|q| &columns[q][j]);
            for (l, column) in block.iter().enumerate() {
                let column = simd.load(column);
                for (sum, b) in sums[l % N].iter_mut().zip(&b) {
                    *sum = simd.mul_add(column, simd.splat(b[l]), *sum);
                }
            }
        }
        let (mut totals, rest) = (sums[0], &sums[1..]);
        for sums in rest {
            for (total, sum) in totals.iter_mut().zip(sums) {
                *total = simd.add(*total, *sum);
            }
        }
        let rows = self.out.chunks_exact_mut(self.blocks).skip(first);
        for (rows, total) in rows.zip(totals) {
            rows[panel.len() - 1] = simd.store(total);
        }
    }
}

impl Wide for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn compute<S: Simd>(mut self, simd: S) {
        let columns = self.b.len() / self.blocks.max(1);
        let mut panels = self.panels;
        for p in 0..self.blocks {
            let (panel, rest) = panels.split_at(p + 1);
            panels = rest;
            // The panel stays in the cache while all columns use it.
            let mut first = 0;
            while first < columns {
                let left = columns - first;
                // Tiles of nearly equal width; the sums of the widest fill the vector registers.
                let width = left.div_ceil(left.div_ceil(S::SUMS));
                match width {
                    1 => self.tile::<S, 1, 4>(simd, panel, first),
                    2 => self.tile::<S, 2, 2>(simd, panel, first),
                    3 => self.tile::<S, 3, 2>(simd, panel, first),
                    4 => self.tile::<S, 4, 1>(simd, panel, first),
                    5 => self.tile::<S, 5, 1>(simd, panel, first),
                    6 => self.tile::<S, 6, 1>(simd, panel, first),
                    7 => self.tile::<S, 7, 1>(simd, panel, first),
                    8 => self.tile::<S, 8, 1>(simd, panel, first),
                    9 => self.tile::<S, 9, 1>(simd, panel, first),
                    _ => self.tile::<S, 10, 1>(simd, panel, first),
                }
                first += width;
            }
        }
    }
}

/// Dot products of `a` with the columns of `b`, which lie one after the other, each as long as `a`.
pub(crate) fn dots(a: &[Lanes], b: &[Lanes], out: &mut [f64]) {
    struct Dots<'a>(&'a [Lanes], &'a [Lanes], &'a mut [f64]);
    impl Wide for Dots<'_> {
        type Output = ();

        #[inline(always)]
        fn compute<S: Simd>(self, simd: S) {
            let Self(a, b, out) = self;
            // Four columns at once: with one each addition would wait for the previous one.
            for (tile, out) in out.chunks_mut(4).enumerate() {
                let column =
                    |q: usize| &b[(4 * tile + q.min(out.len() - 1)) * a.len()..][..a.len()];
                let columns: [&[Lanes]; 4] = std::array::from_fn(column);
                let mut sums = [simd.splat(0.0); 4];
                for (i, a) in a.iter().enumerate() {
                    let a = simd.load(a);
                    for (sum, column) in sums.iter_mut().zip(columns) {
                        *sum = simd.mul_add(a, simd.load(&column[i]), *sum);
                    }
                }
                for (out, sum) in out.iter_mut().zip(sums) {
                    *out = simd.sum(sum);
                }
            }
        }
    }
    wide(Dots(a, b, out));
}

/// Dot product in a fixed order of summation: vectorised and reproducible to the bit.
#[inline(always)]
pub(crate) fn sum_of_products(a: &[f64], b: &[f64]) -> f64 {
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

/// `y += a · x`, inlined into its caller.
#[inline(always)]
pub(crate) fn axpy(y: &mut [f64], a: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y = a.mul_add(*x, *y);
    }
}

/// `a += scale · b` with the widest instructions of the machine.
pub(crate) fn add_scaled(a: &mut [f64], scale: f64, b: &[f64]) {
    struct AddScaled<'a>(&'a mut [f64], f64, &'a [f64]);
    impl Vectorised for AddScaled<'_> {
        type Output = ();

        #[inline(always)]
        fn compute(self) {
            axpy(self.0, self.1, self.2);
        }
    }
    vectorised_loops(AddScaled(a, scale, b));
}
