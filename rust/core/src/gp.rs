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
        let mut sums = [[0.0; LANES]; NY];
        for (block, differences) in self.points.differences(z).enumerate() {
            for (sum, output) in sums.iter_mut().zip(&self.outputs) {
                let value = self.kernel.value(&squared_distance(
                    &differences,
                    &output.inverse_squared_lengthscales,
                ));
                add_product(sum, &value, &output.weights[block]);
            }
        }
        GpOutput::from_fn(|o, _| self.outputs[o].constant + total(&sums[o]))
    }

    /// The predictive mean at a z-scored input, and its Jacobian in the z-scored space.
    pub fn mean_jacobian(&self, z: &GpInput, jacobian: &mut GpJacobian) -> GpOutput {
        let mut sums = [[0.0; LANES]; NY];
        let mut gradients = [[[0.0; LANES]; NZ]; NY];
        for (block, differences) in self.points.differences(z).enumerate() {
            for ((sum, gradient), output) in sums.iter_mut().zip(&mut gradients).zip(&self.outputs)
            {
                let r2 = squared_distance(&differences, &output.inverse_squared_lengthscales);
                let (value, mut slope) = self.kernel.value_slope(&r2);
                let weights = &output.weights[block];
                add_product(sum, &value, weights);
                for (slope, weight) in slope.iter_mut().zip(weights) {
                    *slope *= weight;
                }
                for (gradient, difference) in gradient.iter_mut().zip(&differences) {
                    add_product(gradient, &slope, difference);
                }
            }
        }
        for (o, output) in self.outputs.iter().enumerate() {
            for d in 0..NZ {
                jacobian[(o, d)] =
                    2.0 * output.inverse_squared_lengthscales[d] * total(&gradients[o][d]);
            }
        }
        GpOutput::from_fn(|o, _| self.outputs[o].constant + total(&sums[o]))
    }

    /// The variance of the latent function at a z-scored input; between 0 and the outputscale.
    pub fn variance(&self, z: &GpInput, scratch: &mut VarianceScratch) -> GpOutput {
        let covariances = &mut scratch.covariances;
        GpOutput::from_fn(|o, _| {
            let output = &self.outputs[o];
            covariance_row(
                self.kernel,
                &self.points,
                z,
                &output.inverse_squared_lengthscales,
                output.outputscale,
                covariances,
            );
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
        covariance_row(kernel, points, input, scales, hyper.outputscale, &mut row);
        lower.extend_from_slice(&row[..i]);
        lower.push(hyper.outputscale + hyper.noise);
    }
    Cholesky::factor(lower)
}

/// `k(z, X)` of one output into `row`, whose length becomes the number of points.
fn covariance_row(
    kernel: Kernel,
    points: &Points,
    z: &GpInput,
    scales: &[f64; NZ],
    outputscale: f64,
    row: &mut Vec<f64>,
) {
    row.clear();
    for differences in points.differences(z) {
        let value = kernel.value(&squared_distance(&differences, scales));
        row.extend_from_slice(&value.map(|value| outputscale * value));
    }
    row.truncate(points.len());
}

/// `sum += a · b`, lane by lane.
#[inline(always)]
fn add_product(sum: &mut Lanes, a: &Lanes, b: &Lanes) {
    for l in 0..LANES {
        sum[l] += a[l] * b[l];
    }
}

/// The sum over the lanes, always in the same order.
fn total(lanes: &Lanes) -> f64 {
    lanes.iter().sum()
}
