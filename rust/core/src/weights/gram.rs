//! Gram matrix of a tall matrix.

use crate::kernel::{LANES, Lanes};
use crate::simd::{Simd, Wide, wide};

/// A matrix that grows row by row, and `AᵀA`.
#[derive(Debug, Clone)]
pub(super) struct Gram {
    columns: usize,
    /// Rows in blocks; padding is zero.
    rows: Vec<Lanes>,
    /// `AᵀA`, padded with zeros in both directions.
    products: Vec<Lanes>,
}

impl Gram {
    /// An empty matrix with `columns` columns and memory for `rows` rows.
    pub fn new(columns: usize, rows: usize) -> Self {
        let blocks = columns.div_ceil(LANES);
        Self {
            columns,
            rows: Vec::with_capacity(rows * blocks),
            products: vec![[0.0; LANES]; blocks * blocks * LANES],
        }
    }

    fn blocks(&self) -> usize {
        self.columns.div_ceil(LANES)
    }

    pub fn row_count(&self) -> usize {
        self.rows.len() / self.blocks()
    }

    /// Removes all rows.
    pub fn clear(&mut self) {
        self.rows.clear();
    }

    /// Appends a copy of the row `back` rows before, or a row of zeros if it does not exist, and returns it.
    pub fn repeat(&mut self, back: usize) -> &mut [f64] {
        let (blocks, end) = (self.blocks(), self.rows.len());
        match end.checked_sub(back * blocks) {
            Some(start) => self.rows.extend_from_within(start..start + blocks),
            None => self.rows.resize(end + blocks, [0.0; LANES]),
        }
        &mut self.rows[end..].as_flattened_mut()[..self.columns]
    }

    /// Computes `AᵀA`.
    pub fn multiply(&mut self) {
        let blocks = self.blocks();
        wide(Products {
            rows: &self.rows,
            blocks,
            out: &mut self.products,
        });
    }

    /// Row `i` of `AᵀA`.
    pub fn products(&self, i: usize) -> &[f64] {
        let blocks = self.blocks();
        &self.products[i * blocks..(i + 1) * blocks].as_flattened()[..self.columns]
    }
}

/// The blocks of `AᵀA` on and below the diagonal, and their mirror images.
struct Products<'a> {
    rows: &'a [Lanes],
    blocks: usize,
    out: &'a mut [Lanes],
}

impl Wide for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn compute<S: Simd>(self, simd: S) {
        for i in 0..self.blocks {
            for j in 0..=i {
                let mut tile = [simd.splat(0.0); LANES];
                for row in self.rows.chunks_exact(self.blocks) {
                    let right = simd.load(&row[j]);
                    for (sum, left) in tile.iter_mut().zip(&row[i]) {
                        *sum = simd.mul_add(simd.splat(*left), right, *sum);
                    }
                }
                for (l, sum) in tile.into_iter().enumerate() {
                    let sum = simd.store(sum);
                    self.out[(i * LANES + l) * self.blocks + j] = sum;
                    for (k, product) in sum.into_iter().enumerate() {
                        self.out[(j * LANES + k) * self.blocks + i][l] = product;
                    }
                }
            }
        }
    }
}
