//! The checks on a member's numbers: before it is built, and by what it then predicts.

use std::ops::RangeInclusive;

use super::LibraryError;
use super::data::MemberData;
use super::format::tensor_name;
use super::member::Member;
use super::metadata::INPUTS;
use crate::{GpInput, GpJacobian, NY, NZ, VarianceScratch};

/// Tensors whose numbers must be positive.
const POSITIVE: [&str; 8] = [
    "input_std",
    "target_std",
    "lengthscales",
    "outputscale",
    "noise",
    "single_track",
    "kinematic",
    "resistance",
];
/// Positive numbers whose quotients and squares are finite.
const SCALES: RangeInclusive<f64> = 1e-100..=1e100;
/// Largest residual of `alpha`, z-scored.
const ALPHA_TOLERANCE: f64 = 1e-10;
/// Largest difference to a golden mean or Jacobian, z-scored.
const MEAN_TOLERANCE: f64 = 1e-9;
/// Largest difference to a golden variance, relative to the prior variance.
const VARIANCE_TOLERANCE: f64 = 1e-8;
/// Relative rounding of one kernel value, at least.
const KERNEL_ROUNDING: f64 = 1e-13;

/// Finite numbers, positive scales, and an ordered envelope.
pub(super) fn check_values(data: &MemberData, member: usize) -> Result<(), LibraryError> {
    for (name, _, values) in data.tensors() {
        let tensor = || tensor_name(member, name);
        if let Some(index) = values.iter().position(|value| !value.is_finite()) {
            return Err(LibraryError::NonFinite {
                tensor: tensor(),
                index,
                value: values[index],
            });
        }
        // A member without training points has no latent variance, so that its prior variance may be zero.
        let zero_allowed = name == "outputscale" && data.inputs.is_empty();
        let wrong = |value: f64| !(SCALES.contains(&value) || (value == 0.0 && zero_allowed));
        let positive = POSITIVE.contains(&name);
        if let Some(index) = values.iter().position(|&value| positive && wrong(value)) {
            return Err(LibraryError::NotPositive {
                tensor: tensor(),
                index,
                value: values[index],
            });
        }
    }
    let [min, max] = data.envelope;
    if let Some(input) = (0..NZ).find(|&d| min[d] >= max[d]) {
        let tensor = tensor_name(member, "envelope");
        return Err(LibraryError::Envelope {
            tensor,
            input: INPUTS[input].0,
            min: min[input],
            max: max[input],
        });
    }
    Ok(())
}

/// `(K + s² I) alpha = y - m`, evaluated as `μ(x_i) + s² alpha_i - y_i` at every training point.
pub(super) fn check_alpha(
    data: &MemberData,
    built: &Member,
    member: usize,
) -> Result<(), LibraryError> {
    let mut largest = [0.0_f64; NY];
    for (i, (z, y)) in data.inputs.iter().zip(&data.targets).enumerate() {
        let difference = built.target_scaler().scale(&built.mean(&GpInput::from(*z)))
            - built.target_scaler().scale(&(*y).into());
        for o in 0..NY {
            let residual = (difference[o] + data.noise[o] * data.alpha[o][i]).abs();
            let residual = if residual.is_nan() {
                f64::INFINITY
            } else {
                residual
            };
            largest[o] = largest[o].max(residual);
        }
    }
    for (output, residual) in largest.into_iter().enumerate() {
        let tolerance = ALPHA_TOLERANCE + mean_rounding(data, output);
        if residual > tolerance {
            return Err(LibraryError::Alpha {
                tensor: tensor_name(member, "alpha"),
                output,
                residual,
                tolerance,
            });
        }
    }
    Ok(())
}

/// Errors unless this program reproduces the trainer's predictions at the golden points.
///
/// Tolerances are those of the parity tests, plus what rounding of the exporter's kernel values and covariance can
/// contribute at most: `Σ|alpha|` amplifies the former in the mean, `1/s²` the latter in the variance.
pub(super) fn check_golden(
    data: &MemberData,
    built: &Member,
    member: usize,
) -> Result<(), LibraryError> {
    let (y_std, z_std) = (built.target_scaler().std(), built.input_scaler().std());
    let mut scratch = VarianceScratch::default();
    let mut jacobian = GpJacobian::zeros();
    let mean_tolerances: [f64; NY] =
        std::array::from_fn(|output| MEAN_TOLERANCE + mean_rounding(data, output));
    for (g, z) in data.golden_z.iter().enumerate() {
        let mean = built.mean_jacobian(&(*z).into(), &mut jacobian);
        let variance = built.variance(&(*z).into(), &mut scratch);
        for o in 0..NY {
            let mean_tolerance = mean_tolerances[o];
            let check = |name, index, expected: f64, found: f64, tolerance: f64| {
                if (found - expected).abs() <= tolerance {
                    return Ok(());
                }
                Err(LibraryError::Golden {
                    tensor: tensor_name(member, name),
                    index,
                    expected,
                    found,
                    tolerance,
                })
            };
            check(
                "golden_mean",
                g * NY + o,
                data.golden_mean[g][o],
                mean[o],
                mean_tolerance * y_std[o],
            )?;
            for d in 0..NZ {
                let expected = data.golden_jacobian[g][o][d];
                let tolerance =
                    mean_tolerance * y_std[o] / (z_std[d] * data.lengthscales[o][d].min(1.0));
                check(
                    "golden_jacobian",
                    (g * NY + o) * NZ + d,
                    expected,
                    jacobian[(o, d)],
                    tolerance,
                )?;
            }
            let prior = data.outputscale[o] * y_std[o] * y_std[o];
            let rounding =
                f64::EPSILON * data.inputs.len() as f64 * data.outputscale[o] / data.noise[o];
            let tolerance = (VARIANCE_TOLERANCE + rounding) * prior;
            check(
                "golden_variance",
                g * NY + o,
                data.golden_variance[g][o],
                variance[o],
                tolerance,
            )?;
        }
    }
    Ok(())
}

/// How much the rounding of kernel values can change a mean: their relative error times `outputscale · Σ|alpha|`.
///
/// Exporter and step take distances as `|x|² + |z|² - 2xz`, which rounds like `|x/ℓ|²`, not like the distance.
fn mean_rounding(data: &MemberData, output: usize) -> f64 {
    let scaled = |x: &[f64; NZ], d: usize| {
        (x[d] - data.input_mean[d]) / (data.input_std[d] * data.lengthscales[output][d])
    };
    let norm = |x: &[f64; NZ]| (0..NZ).map(|d| scaled(x, d).powi(2)).sum::<f64>();
    let widest = data.inputs.iter().map(norm).fold(0.0, f64::max);
    let relative = KERNEL_ROUNDING.max(8.0 * f64::EPSILON * widest);
    let sum: f64 = data.alpha[output].iter().map(|alpha| alpha.abs()).sum();
    relative * data.outputscale[output] * sum
}
