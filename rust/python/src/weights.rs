//! The QP of the weights by itself.

use egp_core::settings::Prior;
use egp_core::weights::{WeightEstimator, WindowNoise};
use egp_core::{GpOutput, NY};
use pyo3::prelude::*;

use crate::array::{Cube, Matrix, NewVector, Vector, fixed, rows, vector, wrong_shape};
use crate::error::InvalidArgumentError;

/// Largest strength of the weights' prior, with which its products with weights are finite.
const MOST_STRENGTH: f64 = 1e300;

#[doc = doc!(solve_weights)]
#[pyfunction]
#[pyo3(signature = (predictions, measured, noise_std, previous, prior, strength, measurement_std=None))]
#[expect(clippy::too_many_arguments, reason = "a keyword each in Python")]
pub fn solve_weights<'py>(
    py: Python<'py>,
    predictions: Cube<'py>,
    measured: Matrix<'py>,
    noise_std: Vector<'py>,
    previous: Vector<'py>,
    prior: &str,
    strength: f64,
    measurement_std: Option<Vector<'py>>,
) -> PyResult<NewVector<'py>> {
    let measured = rows::<NY>("measured", &measured)?;
    let noise = GpOutput::from(fixed::<NY>("noise_std", &noise_std)?);
    let state_noise = match &measurement_std {
        Some(std) => GpOutput::from(fixed::<NY>("measurement_std", std)?),
        None => GpOutput::zeros(),
    };
    let previous: Vec<f64> = previous.as_array().iter().copied().collect();
    let shape = [measured.len(), previous.len(), NY];
    if predictions.as_array().shape() != shape {
        let expected = format!("({}, {}, {NY})", shape[0], shape[1]);
        return Err(wrong_shape(
            "predictions",
            &expected,
            predictions.as_array().shape(),
        ));
    }
    let prior = checked_prior(prior, strength)?;
    let predictions: Vec<f64> = predictions.as_array().iter().copied().collect();
    check_domains(&predictions, &measured, [&noise, &state_noise], &previous)?;
    let mut w = vec![0.0; previous.len()];
    py.detach(|| {
        WeightEstimator::new(previous.len(), measured.len()).estimate(
            &predictions,
            &measured,
            &WindowNoise::new(&noise, &state_noise, measured.len()),
            prior,
            &previous,
            &mut w,
        )
    });
    let squares = errors_squared(&predictions, &measured, &noise);
    if !squares.is_finite() || !w.iter().all(|w| w.is_finite()) {
        return Err(InvalidArgumentError::new_err(
            "the squares of the errors over noise_std are too large for a number: check the units",
        ));
    }
    Ok(vector(py, w))
}

/// The prior of the weights with this name and strength.
fn checked_prior(name: &str, strength: f64) -> PyResult<Prior> {
    let prior = match name {
        "quadratic" => Prior::Quadratic { lambda: strength },
        "l1" => Prior::L1 { alpha: strength },
        other => {
            return Err(InvalidArgumentError::new_err(format!(
                "prior must be \"quadratic\" or \"l1\", got {other:?}"
            )));
        }
    };
    if !(0.0..=MOST_STRENGTH).contains(&strength) {
        return Err(InvalidArgumentError::new_err(format!(
            "strength must be a number from 0 to {MOST_STRENGTH:e}, got {strength}"
        )));
    }
    Ok(prior)
}

/// Errors unless the numbers of [`solve_weights`] are in their domains; the standard deviations are those of the errors of the
/// predictions and of the measured states.
fn check_domains(
    predictions: &[f64],
    measured: &[[f64; NY]],
    [noise, state_noise]: [&GpOutput; 2],
    previous: &[f64],
) -> PyResult<()> {
    let mut numbers = predictions.iter().chain(measured.as_flattened());
    let sum: f64 = previous.iter().sum();
    // Within these bounds the squares of the standard deviations are finite, and those of `noise_std` are not zero.
    for (valid, expected) in [
        (
            numbers.all(|v| v.is_finite()),
            "finite predictions and measured changes",
        ),
        (
            noise.iter().all(|std| (1e-100..1e100).contains(std)),
            "noise_std from 1e-100 to 1e100",
        ),
        (
            state_noise.iter().all(|std| (0.0..1e100).contains(std)),
            "measurement_std from 0 to 1e100",
        ),
        (
            previous.iter().all(|w| *w >= 0.0) && (sum - 1.0).abs() <= 1e-9,
            "previous weights on the simplex, not negative and with the sum 1",
        ),
    ] {
        if !valid {
            let message = format!("expected {expected}");
            return Err(InvalidArgumentError::new_err(message));
        }
    }
    Ok(())
}

/// Sum of the squares of all errors, in standard deviations of the noise. Predictions are ordered by transition and member.
fn errors_squared(predictions: &[f64], measured: &[[f64; NY]], noise: &GpOutput) -> f64 {
    let members = predictions.len() / (NY * measured.len().max(1));
    let (rows, _) = predictions.as_chunks::<NY>();
    let measured = measured
        .iter()
        .flat_map(|row| std::iter::repeat_n(row, members));
    let errors = rows.iter().zip(measured).flat_map(|(row, measured)| {
        let pairs = row.iter().zip(measured).zip(noise.iter());
        pairs.map(|((predicted, measured), std)| (predicted - measured) / std)
    });
    errors.map(|error| error * error).sum()
}
