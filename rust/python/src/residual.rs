//! The residual of the control step by itself.

use egp_core::residual::ResidualFilter;
use egp_core::settings::ResidualSettings;
use egp_core::{GpOutput, NY};
use pyo3::prelude::*;

use crate::array::{Matrix, NewMatrix, Vector, array, fixed, rows};
use crate::error::InvalidArgumentError;

#[doc = doc!(predict_residual)]
#[pyfunction]
#[pyo3(signature = (errors, *, dt, window, std, time, noise, measurement))]
#[expect(clippy::too_many_arguments, reason = "a keyword each in Python")]
pub fn predict_residual<'py>(
    py: Python<'py>,
    errors: Matrix<'py>,
    dt: f64,
    window: usize,
    std: Vector<'py>,
    time: Vector<'py>,
    noise: Vector<'py>,
    measurement: Vector<'py>,
) -> PyResult<(NewMatrix<'py>, NewMatrix<'py>)> {
    let errors = rows::<NY>("errors", &errors)?;
    let settings = ResidualSettings {
        std: fixed::<NY>("std", &std)?,
        time: fixed::<NY>("time", &time)?,
        noise: fixed::<NY>("noise", &noise)?,
        measurement: fixed::<NY>("measurement", &measurement)?,
    };
    settings.validate().map_err(InvalidArgumentError::raise)?;
    if let Some(error) = errors.as_flattened().iter().find(|e| !e.is_finite()) {
        let message = format!("errors must be finite, got {error}");
        return Err(InvalidArgumentError::new_err(message));
    }
    if !(1e-6..=1e3).contains(&dt) {
        let message = format!("dt must be from 1e-6 to 1000 s, got {dt}");
        return Err(InvalidArgumentError::new_err(message));
    }
    if !(1..=1000).contains(&window) {
        let message = format!("window must be from 1 to 1000 transitions, got {window}");
        return Err(InvalidArgumentError::new_err(message));
    }
    let (mut mean, mut variance) = py.detach(|| {
        let (mut mean, mut variance) = (vec![], vec![]);
        if let Some(filter) = ResidualFilter::new(&settings, dt, window) {
            for k in 0..errors.len() {
                let before = errors[k.saturating_sub(window)..k].iter();
                let residual = filter.estimate(before.map(|error| GpOutput::from(*error)));
                let next = residual.ahead().next().unwrap_or_default();
                mean.extend(&next.0);
                variance.extend(&next.1);
            }
        }
        (mean, variance)
    });
    let shape = [errors.len(), NY];
    mean.resize(errors.as_flattened().len(), 0.0);
    variance.resize(errors.as_flattened().len(), 0.0);
    Ok((array(py, mean, shape)?, array(py, variance, shape)?))
}
