//! Exact Gaussian-process regression of the three outputs over shared training inputs, in the z-scored space.
//!
//! Rasmussen & Williams (2006), eqs. (2.25), (2.26); for each output
//! ```text
//! mean      μ(z)  = m + k(z, X) α,                          α = (K + s² I)⁻¹ (y - m)
//! gradient  ∂μ/∂z_d = 2/ℓ_d² (z_d Σ_j s_j - Σ_j s_j x_jd),   s_j = α_j outputscale φ'(r_j²)
//! variance  σ²(z) = k(z, z) - |L⁻¹ k(X, z)|²,               L Lᵀ = K + s² I
//! ```
//! The variance is that of the latent function: measurement noise is not included.
//!
//! Each output may have its own hyperparameters. If all but `m` agree, as in libraries trained with one kernel for all
//! outputs, `K + s² I` is factored once, and distances, exponentials and variances are computed once.

mod horizon;
mod mean;

pub(crate) use horizon::HorizonScratch;
use mean::{CovarianceRow, Mean, mean_jacobian};

use std::ops::Range;

use crate::cholesky::{InverseFactor, NotPositiveDefinite, dots};
use crate::kernel::{Kernel, LANES, Lanes, Metric, Points, in_blocks};
use crate::simd::wide;
use crate::{GpInput, GpJacobian, GpOutput, NY, NZ};

/// Hyperparameters of one output in the z-scored space.
#[derive(Clone, Debug, PartialEq)]
pub struct Hyperparameters {
    /// `ℓ`, one for each input dimension.
    pub lengthscales: [f64; NZ],
    /// Prior variance of the latent function.
    pub outputscale: f64,
    /// Variance `s²` of the targets' noise.
    pub noise: f64,
    /// Prior mean `m`.
    pub constant: f64,
}

/// Memory for variances; grows at its first use and is then reused.
#[derive(Clone, Debug, Default)]
pub struct VarianceScratch {
    /// `k(X, z)` and `L⁻¹ k(X, z)`.
    covariances: [Vec<Lanes>; 2],
}

/// Three independent exact GPs, one for each output, over the same training inputs.
#[derive(Clone, Debug)]
pub(crate) struct Gp {
    kernel: Kernel,
    points: Points,
    /// One covariance for all outputs, or one for each output.
    covariances: Vec<Covariance>,
    outputs: [Output; NY],
}

/// Data of a GP that do not depend on the targets: kernel parameters and the inverse factor of `K + s² I`.
#[derive(Clone, Debug)]
struct Covariance {
    metric: Metric,
    outputscale: f64,
    inverse: InverseFactor,
}

#[derive(Clone, Debug)]
struct Output {
    constant: f64,
    /// `outputscale · α`.
    weights: Vec<Lanes>,
}

/// `K + s² I` of one output is not positive definite: its factorisation failed at a training point.
#[derive(Debug)]
pub(crate) struct SingularCovariance {
    /// Index of the first output with this covariance.
    pub output: usize,
    /// Index of the training point.
    pub point: usize,
}

impl Gp {
    /// A GP over z-scored training inputs; factors the covariances. `alpha` is not checked against them.
    ///
    /// Cost: `n³/3` multiplications and `n²/2` numbers of memory for each covariance.
    ///
    /// # Errors
    /// [`SingularCovariance`].
    pub fn new(
        kernel: Kernel,
        inputs: &[GpInput],
        hyperparameters: &[Hyperparameters; NY],
        alpha: &[Vec<f64>; NY],
    ) -> Result<Self, SingularCovariance> {
        let points = Points::new(inputs);
        let [first, others @ ..] = hyperparameters;
        let shared = others.iter().all(|other| first.same_covariance(other));
        let distinct = if shared { 1 } else { NY };
        let covariances = hyperparameters.iter().take(distinct).enumerate();
        let covariances = covariances
            .map(|(output, hyper)| {
                Covariance::new(kernel, &points, inputs, hyper)
                    .map_err(|NotPositiveDefinite(point)| SingularCovariance { output, point })
            })
            .collect::<Result<_, _>>()?;
        let outputs = std::array::from_fn(|o| {
            let Hyperparameters {
                outputscale,
                constant,
                ..
            } = hyperparameters[o];
            let mut weights = Vec::new();
            in_blocks(
                alpha[o].iter().map(|alpha| outputscale * alpha),
                &mut weights,
            );
            Output { constant, weights }
        });
        Ok(Self {
            kernel,
            points,
            covariances,
            outputs,
        })
    }

    /// Number of training points.
    pub fn n_points(&self) -> usize {
        self.points.len()
    }

    /// The predictive mean at a z-scored input.
    pub fn mean(&self, z: &GpInput) -> GpOutput {
        wide(self.kernel.with(Mean { gp: self, z }))
    }

    /// The predictive mean at a z-scored input, and its Jacobian in the z-scored space.
    pub fn mean_jacobian(&self, z: &GpInput, jacobian: &mut GpJacobian) -> GpOutput {
        mean_jacobian(self, z, jacobian)
    }

    /// The variance of the latent function at a z-scored input; between 0 and the outputscale.
    pub fn variance(&self, z: &GpInput, scratch: &mut VarianceScratch) -> GpOutput {
        let [covariances, product] = &mut scratch.covariances;
        covariances.resize(self.points.blocks().len(), [0.0; LANES]);
        product.resize(covariances.len(), [0.0; LANES]);
        let mut variance = GpOutput::zeros();
        for (outputs, covariance) in self.by_covariance() {
            wide(self.kernel.with(CovarianceRow {
                outputscale: covariance.outputscale,
                points: &self.points,
                norms: covariance.metric.norms(),
                query: &covariance.metric.query(z),
                row: covariances,
            }));
            covariance.inverse.products(covariances, product);
            let mut explained = [0.0];
            dots(product, product, &mut explained);
            // Rounding may give a tiny negative number near a training point.
            let remaining = (covariance.outputscale - explained[0]).max(0.0);
            outputs.for_each(|o| variance[o] = remaining);
        }
        variance
    }

    /// Each covariance with the outputs that share it.
    fn by_covariance(&self) -> impl Iterator<Item = (Range<usize>, &Covariance)> {
        let width = NY / self.covariances.len();
        let outputs = (0..NY).step_by(width).map(move |o| o..o + width);
        outputs.zip(&self.covariances)
    }
}

impl Hyperparameters {
    /// Whether the targets of two outputs have the same covariance.
    fn same_covariance(&self, other: &Self) -> bool {
        let covariance = |hyper: &Self| (hyper.lengthscales, hyper.outputscale, hyper.noise);
        covariance(self) == covariance(other)
    }
}

impl Covariance {
    fn new(
        kernel: Kernel,
        points: &Points,
        inputs: &[GpInput],
        hyper: &Hyperparameters,
    ) -> Result<Self, NotPositiveDefinite> {
        let metric = Metric::new(kernel.scale(), &hyper.lengthscales, inputs);
        let mut lower = Vec::with_capacity(inputs.len() * (inputs.len() + 1) / 2);
        let mut row = vec![[0.0; LANES]; points.blocks().len()];
        for (i, input) in inputs.iter().enumerate() {
            wide(kernel.with(CovarianceRow {
                outputscale: hyper.outputscale,
                points,
                norms: metric.norms(),
                query: &metric.query(input),
                row: &mut row,
            }));
            lower.extend_from_slice(&row.as_flattened()[..i]);
            lower.push(hyper.outputscale + hyper.noise);
        }
        Ok(Self {
            metric,
            outputscale: hyper.outputscale,
            inverse: InverseFactor::new(inputs.len(), lower)?,
        })
    }
}
