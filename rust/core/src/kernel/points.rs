//! Memory layout of training inputs for the kernel's inner loop.

use super::{LANES, Lanes};
use crate::simd::Simd;
use crate::{GpInput, NZ};

/// Training inputs in blocks of [`LANES`] points, dimension by dimension inside a block.
///
/// All outputs of a GP share one copy. The last block is padded with zeros; sums over points must give the padding the
/// weight zero.
#[derive(Clone, Debug, Default)]
pub(crate) struct Points {
    len: usize,
    blocks: Vec<[Lanes; NZ]>,
}

impl Points {
    /// Copies inputs into blocks.
    pub fn new(inputs: &[GpInput]) -> Self {
        let mut points = Self::default();
        points.assign(inputs);
        points
    }

    /// Replaces the inputs, reusing the memory.
    pub fn assign(&mut self, inputs: &[GpInput]) {
        let block = |chunk: &[GpInput]| {
            std::array::from_fn(|d| {
                std::array::from_fn(|l| chunk.get(l).map_or(0.0, |point| point[d]))
            })
        };
        self.len = inputs.len();
        self.blocks.clear();
        self.blocks.extend(inputs.chunks(LANES).map(block));
    }

    /// Number of points, padding not counted.
    pub fn len(&self) -> usize {
        self.len
    }

    /// The blocks.
    pub fn blocks(&self) -> &[[Lanes; NZ]] {
        &self.blocks
    }
}

/// Writes one number for each point in blocks of [`LANES`], padded with zeros.
pub(crate) fn in_blocks(values: impl ExactSizeIterator<Item = f64>, blocks: &mut Vec<Lanes>) {
    blocks.clear();
    blocks.resize(values.len().div_ceil(LANES), [0.0; LANES]);
    for (slot, value) in blocks.as_flattened_mut().iter_mut().zip(values) {
        *slot = value;
    }
}

/// Squared scaled distances `t = scale · Σ_d (z_d - x_d)² / ℓ_d²` from training points to a query, where `scale` is
/// the kernel's [`Profile::SCALE`](super::Profile::SCALE).
///
/// Computed as `t = norm(x) + norm(z) + Σ_d c_d x_d`, `c_d = -2 scale z_d / ℓ_d²`, `norm(v) = scale Σ_d v_d² / ℓ_d²`:
/// this takes half the operations of the sum of squares and uses points that all outputs share. The rounding error is
/// at most `5 eps (|norm(x)| + |norm(z)|)`, about 1e-14 for z-scored points a few lengthscales from the origin, and it
/// becomes the kernel's relative error.
#[derive(Clone, Debug)]
pub(crate) struct Metric {
    scale: f64,
    inverse_squared_lengthscales: [f64; NZ],
    norms: Vec<Lanes>,
}

/// Coefficients of the distances to one query point, see [`Metric`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Query {
    coefficients: [f64; NZ],
    norm: f64,
}

impl Metric {
    /// The metric of one output over training inputs.
    pub fn new(scale: f64, lengthscales: &[f64; NZ], inputs: &[GpInput]) -> Self {
        let mut metric = Self {
            scale,
            inverse_squared_lengthscales: lengthscales.map(|l| 1.0 / (l * l)),
            norms: Vec::new(),
        };
        let mut norms = Vec::new();
        metric.norms_of(inputs, &mut norms);
        metric.norms = norms;
        metric
    }

    /// `norm(x)` of other points, in blocks.
    pub fn norms_of(&self, inputs: &[GpInput], norms: &mut Vec<Lanes>) {
        in_blocks(inputs.iter().map(|x| self.norm(x)), norms);
    }

    fn norm(&self, v: &GpInput) -> f64 {
        let squares = v.iter().zip(&self.inverse_squared_lengthscales);
        self.scale * squares.map(|(v, s)| v * v * s).sum::<f64>()
    }

    /// `1 / ℓ_d²`.
    pub fn inverse_squared_lengthscales(&self) -> &[f64; NZ] {
        &self.inverse_squared_lengthscales
    }

    /// `norm(x)` of the training points, in their blocks.
    pub fn norms(&self) -> &[Lanes] {
        &self.norms
    }

    /// Coefficients of the distances to `z`.
    #[inline(always)]
    pub fn query(&self, z: &GpInput) -> Query {
        Query {
            coefficients: std::array::from_fn(|d| {
                -2.0 * self.scale * z[d] * self.inverse_squared_lengthscales[d]
            }),
            norm: self.norm(z),
        }
    }
}

impl Query {
    /// `t` for a block of points with their norms. Two running sums halve the chain of dependent additions.
    #[inline(always)]
    pub fn distances<S: Simd>(&self, simd: S, block: &[Lanes; NZ], norms: &Lanes) -> S::V {
        let mut even = simd.add(simd.load(norms), simd.splat(self.norm));
        let mut odd = simd.splat(0.0);
        for (c, x) in (self.coefficients.as_chunks::<2>().0.iter()).zip(block.as_chunks::<2>().0) {
            even = simd.mul_add(simd.splat(c[0]), simd.load(&x[0]), even);
            odd = simd.mul_add(simd.splat(c[1]), simd.load(&x[1]), odd);
        }
        simd.add(even, odd)
    }
}
