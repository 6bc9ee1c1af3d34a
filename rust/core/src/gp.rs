//! Exact Gaussian-process regression of the three outputs over shared training inputs, in the z-scored space.
//!
//! Rasmussen & Williams (2006), eqs. (2.25), (2.26); for each output with its own hyperparameters
//! ```text
//! mean      μ(z)  = m + k(z, X) α,                    α = (K + s² I)⁻¹ (y - m)
//! gradient  ∂μ/∂z = Σ_j α_j ∂k(z, x_j)/∂z,            ∂k/∂z_d = 2 outputscale φ'(r²) (z_d - x_jd) / ℓ_d²
//! variance  σ²(z) = k(z, z) - |L⁻¹ k(X, z)|²,         L Lᵀ = K + s² I
//! ```
//! The variance is that of the latent function: measurement noise is not included.

use crate::cholesky::{Cholesky, NotPositiveDefinite, dot};
use crate::kernel::{Kernel, LANES, Lanes, Points, in_blocks, squared_distance};
use crate::simd::{Vectorised, vectorised};
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

/// Memory for [`Gp::variance`]; grows at its first use and is then reused.
#[derive(Clone, Debug, Default)]
pub struct VarianceScratch {
    covariances: Vec<f64>,
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
    inverse_squared_lengthscales: [f64; NZ],
    outputscale: f64,
    constant: f64,
    /// `outputscale · α`.
    weights: Vec<Lanes>,
    factor: Cholesky,
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
    /// Cost: `n³/6` multiplications and `n²/2` numbers of memory for each output.
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
            let scales = hyper.lengthscales.map(|l| 1.0 / (l * l));
            let factor = factor(kernel, &points, inputs, hyper, &scales)
                .map_err(|NotPositiveDefinite(point)| SingularCovariance { output, point })?;
            Ok(Output {
                inverse_squared_lengthscales: scales,
                outputscale: hyper.outputscale,
                constant: hyper.constant,
                weights: in_blocks(alpha[output].iter().map(|alpha| hyper.outputscale * alpha)),
                factor,
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
        vectorised(Mean { gp: self, z })
    }

    /// The predictive mean at a z-scored input, and its Jacobian in the z-scored space.
    pub fn mean_jacobian(&self, z: &GpInput, jacobian: &mut GpJacobian) -> GpOutput {
        vectorised(MeanJacobian {
            gp: self,
            z,
            jacobian,
        })
    }

    /// The variance of the latent function at a z-scored input; between 0 and the outputscale.
    pub fn variance(&self, z: &GpInput, scratch: &mut VarianceScratch) -> GpOutput {
        let covariances = &mut scratch.covariances;
        GpOutput::from_fn(|o, _| {
            let output = &self.outputs[o];
            vectorised(CovarianceRow {
                kernel: self.kernel,
                points: &self.points,
                z,
                scales: &output.inverse_squared_lengthscales,
                outputscale: output.outputscale,
                row: covariances,
            });
            output.factor.half_solve(covariances);
            // Rounding may leave a tiny negative number next to a training point.
            (output.outputscale - dot(covariances, covariances)).max(0.0)
        })
    }
}

/// Factors `K + s² I` of one output.
fn factor(
    kernel: Kernel,
    points: &Points,
    inputs: &[GpInput],
    hyper: &Hyperparameters,
    scales: &[f64; NZ],
) -> Result<Cholesky, NotPositiveDefinite> {
    let mut lower = Vec::with_capacity(inputs.len() * (inputs.len() + 1) / 2);
    let mut row = Vec::new();
    for (i, input) in inputs.iter().enumerate() {
        vectorised(CovarianceRow {
            kernel,
            points,
            z: input,
            scales,
            outputscale: hyper.outputscale,
            row: &mut row,
        });
        lower.extend_from_slice(&row[..i]);
        lower.push(hyper.outputscale + hyper.noise);
    }
    Cholesky::factor(inputs.len(), lower)
}

/// [`Gp::mean`].
struct Mean<'a> {
    gp: &'a Gp,
    z: &'a GpInput,
}

impl Vectorised for Mean<'_> {
    type Output = GpOutput;

    #[inline(always)]
    fn compute(self) -> GpOutput {
        let Self { gp, z } = self;
        let mut sums = [[0.0; LANES]; NY];
        for (block, differences) in gp.points.differences(z).enumerate() {
            for (sum, output) in sums.iter_mut().zip(&gp.outputs) {
                let r2 = squared_distance(&differences, &output.inverse_squared_lengthscales);
                add_product(sum, &gp.kernel.value(&r2), &output.weights[block]);
            }
        }
        GpOutput::from_fn(|o, _| gp.outputs[o].constant + total(&sums[o]))
    }
}

/// [`Gp::mean_jacobian`].
struct MeanJacobian<'a> {
    gp: &'a Gp,
    z: &'a GpInput,
    jacobian: &'a mut GpJacobian,
}

impl Vectorised for MeanJacobian<'_> {
    type Output = GpOutput;

    /// One output after the other: its seven sums stay in registers, and the points in the first-level cache.
    #[inline(always)]
    fn compute(self) -> GpOutput {
        let Self { gp, z, jacobian } = self;
        let mut mean = GpOutput::zeros();
        for (o, output) in gp.outputs.iter().enumerate() {
            let scales = &output.inverse_squared_lengthscales;
            let mut sum = [0.0; LANES];
            let mut gradient = [[0.0; LANES]; NZ];
            for (differences, weights) in gp.points.differences(z).zip(&output.weights) {
                let (value, mut slope) = gp
                    .kernel
                    .value_slope(&squared_distance(&differences, scales));
                add_product(&mut sum, &value, weights);
                for (slope, weight) in slope.iter_mut().zip(weights) {
                    *slope *= weight;
                }
                for (gradient, difference) in gradient.iter_mut().zip(&differences) {
                    add_product(gradient, &slope, difference);
                }
            }
            mean[o] = output.constant + total(&sum);
            for d in 0..NZ {
                jacobian[(o, d)] = 2.0 * scales[d] * total(&gradient[d]);
            }
        }
        mean
    }
}

/// `k(z, X)` of one output into `row`, whose length becomes the number of points.
struct CovarianceRow<'a> {
    kernel: Kernel,
    points: &'a Points,
    z: &'a GpInput,
    scales: &'a [f64; NZ],
    outputscale: f64,
    row: &'a mut Vec<f64>,
}

impl Vectorised for CovarianceRow<'_> {
    type Output = ();

    #[inline(always)]
    fn compute(self) {
        self.row.clear();
        for differences in self.points.differences(self.z) {
            let value = self
                .kernel
                .value(&squared_distance(&differences, self.scales));
            self.row
                .extend_from_slice(&value.map(|value| self.outputscale * value));
        }
        self.row.truncate(self.points.len());
    }
}

/// `sum += a · b`, lane by lane.
#[inline(always)]
fn add_product(sum: &mut Lanes, a: &Lanes, b: &Lanes) {
    for l in 0..LANES {
        sum[l] = a[l].mul_add(b[l], sum[l]);
    }
}

/// The sum over the lanes, always in the same order.
fn total(lanes: &Lanes) -> f64 {
    lanes.iter().sum()
}
