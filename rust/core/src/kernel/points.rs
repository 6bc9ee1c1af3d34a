//! Training inputs laid out for the kernel's inner loop.

use super::{LANES, Lanes};
use crate::{GpInput, NZ};

/// Training inputs in blocks of [`LANES`] points, dimension by dimension inside a block.
///
/// One copy serves all outputs of a GP: differences to the query are formed once, and each output weighs their
/// squares by its own lengthscales. The last block is filled up with zeros; whoever sums over points gives those
/// lanes the weight zero.
#[derive(Clone, Debug)]
pub struct Points {
    len: usize,
    blocks: Vec<[Lanes; NZ]>,
}

impl Points {
    /// Lays out training inputs.
    pub fn new(inputs: &[GpInput]) -> Self {
        let block = |chunk: &[GpInput]| {
            std::array::from_fn(|d| {
                std::array::from_fn(|l| chunk.get(l).map_or(0.0, |point| point[d]))
            })
        };
        Self {
            len: inputs.len(),
            blocks: inputs.chunks(LANES).map(block).collect(),
        }
    }

    /// Number of points, padding not counted.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no point at all.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Per block the differences `z_d - x_d` to a query `z`.
    #[inline(always)]
    pub fn differences(&self, z: &GpInput) -> impl Iterator<Item = [Lanes; NZ]> {
        let z: [f64; NZ] = (*z).into();
        self.blocks
            .iter()
            .map(move |block| std::array::from_fn(|d| block[d].map(|x| z[d] - x)))
    }
}

/// Numbers, one for each training point, in blocks of [`LANES`]; padding is zero.
pub fn in_blocks(values: impl ExactSizeIterator<Item = f64>) -> Vec<Lanes> {
    let mut blocks = vec![[0.0; LANES]; values.len().div_ceil(LANES)];
    for (slot, value) in blocks.as_flattened_mut().iter_mut().zip(values) {
        *slot = value;
    }
    blocks
}

/// `r² = Σ_d differences_d² · inverse_squared_lengthscales_d` for a block of points.
#[inline(always)]
pub fn squared_distance(
    differences: &[Lanes; NZ],
    inverse_squared_lengthscales: &[f64; NZ],
) -> Lanes {
    let mut r2 = [0.0; LANES];
    for (difference, scale) in differences.iter().zip(inverse_squared_lengthscales) {
        for (r2, difference) in r2.iter_mut().zip(difference) {
            *r2 = (difference * difference).mul_add(*scale, *r2);
        }
    }
    r2
}
