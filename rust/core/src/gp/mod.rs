//! Exact Gaussian-process regression of the three outputs over shared training inputs, in the z-scored space.
//!
//! Rasmussen & Williams (2006), eqs. (2.25), (2.26); for each output with its own hyperparameters
//! ```text
//! mean      μ(z)  = m + k(z, X) α,                          α = (K + s² I)⁻¹ (y - m)
//! gradient  ∂μ/∂z_d = 2/ℓ_d² (z_d Σ_j s_j - Σ_j s_j x_jd),   s_j = α_j outputscale φ'(r_j²)
//! variance  σ²(z) = k(z, z) - |L⁻¹ k(X, z)|²,               L Lᵀ = K + s² I
//! ```
//! The variance is that of the latent function: measurement noise is not included.

mod horizon;
mod mean;

pub(crate) use horizon::Horizon;
use mean::{CovarianceRow, Mean, MeanJacobian};

use crate::cholesky::{InverseFactor, NotPositiveDefinite, dot};
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
    /// Variance `s²` of the measurement noise.
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
pub struct Gp {
    kernel: Kernel,
    points: Points,
    outputs: [Output; NY],
}

#[derive(Clone, Debug)]
struct Output {
    metric: Metric,
    outputscale: f64,
    constant: f64,
    /// `outputscale · α`.
    weights: Vec<Lanes>,
    inverse: InverseFactor,
}

/// `K + s² I` of one output is not positive definite: its factorisation failed at a training point.
#[derive(Debug)]
pub struct SingularCovariance {
    /// Index of the output.
    pub output: usize,
    /// Index of the training point.
    pub point: usize,
}

impl Gp {
    /// Lays out the training inputs (z-scored) and factors the covariances; `alpha` is taken as it is.
    ///
    /// Cost: `n³/3` multiplications and `n²/2` numbers of memory for each output.
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
        let output = |output: usize| {
            let hyper = &hyperparameters[output];
            let metric = Metric::new(kernel.scale(), &hyper.lengthscales, inputs);
            let inverse = inverse_factor(kernel, &points, inputs, hyper, &metric)
                .map_err(|NotPositiveDefinite(point)| SingularCovariance { output, point })?;
            let mut weights = Vec::new();
            in_blocks(
                alpha[output].iter().map(|alpha| hyper.outputscale * alpha),
                &mut weights,
            );
            Ok(Output {
                metric,
                outputscale: hyper.outputscale,
                constant: hyper.constant,
                weights,
                inverse,
            })
        };
        let outputs = [output(0)?, output(1)?, output(2)?];
        Ok(Self {
            kernel,
            points,
            outputs,
        })
    }

    /// Number of training points.
    pub fn n_points(&self) -> usize {
        self.points.len()
    }

    /// The predictive mean at a z-scored input.
    pub fn mean(&self, z: &GpInput) -> GpOutput {
        wide(Mean { gp: self, z })
    }

    /// The predictive mean at a z-scored input, and its Jacobian in the z-scored space.
    pub fn mean_jacobian(&self, z: &GpInput, jacobian: &mut GpJacobian) -> GpOutput {
        wide(MeanJacobian {
            gp: self,
            z,
            jacobian,
        })
    }

    /// The variance of the latent function at a z-scored input; between 0 and the outputscale.
    pub fn variance(&self, z: &GpInput, scratch: &mut VarianceScratch) -> GpOutput {
        let [covariances, product] = &mut scratch.covariances;
        covariances.resize(self.points.blocks().len(), [0.0; LANES]);
        product.resize(covariances.len(), [0.0; LANES]);
        GpOutput::from_fn(|o, _| {
            let output = &self.outputs[o];
            wide(CovarianceRow {
                kernel: self.kernel,
                outputscale: output.outputscale,
                points: &self.points,
                norms: output.metric.norms(),
                query: &output.metric.query(z),
                row: covariances,
            });
            output.inverse.products([covariances], [product]);
            let explained = dot(product, product);
            // Rounding may leave a tiny negative number next to a training point.
            (output.outputscale - explained).max(0.0)
        })
    }
}

/// `L⁻¹`, `L Lᵀ = K + s² I`, of one output.
fn inverse_factor(
    kernel: Kernel,
    points: &Points,
    inputs: &[GpInput],
    hyper: &Hyperparameters,
    metric: &Metric,
) -> Result<InverseFactor, NotPositiveDefinite> {
    let mut lower = Vec::with_capacity(inputs.len() * (inputs.len() + 1) / 2);
    let mut row = vec![[0.0; LANES]; points.blocks().len()];
    for (i, input) in inputs.iter().enumerate() {
        wide(CovarianceRow {
            kernel,
            outputscale: hyper.outputscale,
            points,
            norms: metric.norms(),
            query: &metric.query(input),
            row: &mut row,
        });
        lower.extend_from_slice(&row.as_flattened()[..i]);
        lower.push(hyper.outputscale + hyper.noise);
    }
    InverseFactor::new(inputs.len(), lower)
}
