//! The QP of a step and that of the weights by themselves, for comparison with other solvers.

use std::time::Instant;

use egp_core::settings::{Prior, SolverKind, SolverSettings};
use egp_core::solver::{solve_with_fallback, solvers};
use egp_core::weights::{WeightEstimator, WindowNoise};
use egp_core::{GpOutput, Input, NU, NX, NY, OcpSolution};
use egp_wire::status_name;
use pyo3::prelude::*;
use serde::Deserialize as _;
use serde::de::IntoDeserializer as _;
use serde::de::value::Error;

use crate::array::{ArrayLike, Cube, KeptMatrix, Matrix, NewVector, Vector};
use crate::array::{array, fixed, rows, vector, wrong_shape};
use crate::error::{InvalidArgumentError, raise};
use crate::problem::{Arrays, OcpBounds, OcpWeights, scale_soft_rows};

/// Largest strength of the weights' prior, with which its products with weights are finite.
const MOST_STRENGTH: f64 = 1e300;

#[doc = doc!(OcpResult)]
#[pyclass(frozen, get_all, module = "egp_service._core")]
pub struct OcpResult {
    #[doc = doc!(OcpResult.status)]
    status: &'static str,
    #[doc = doc!(OcpResult.x)]
    x: KeptMatrix,
    #[doc = doc!(OcpResult.u)]
    u: KeptMatrix,
    #[doc = doc!(OcpResult.iterations)]
    iterations: u32,
    #[doc = doc!(OcpResult.kkt_residual)]
    kkt_residual: f64,
    #[doc = doc!(OcpResult.solver)]
    solver: &'static str,
    #[doc = doc!(OcpResult.seconds)]
    seconds: f64,
}

#[pymethods]
impl OcpResult {
    fn __repr__(&self) -> String {
        let Self {
            status,
            iterations,
            kkt_residual,
            solver,
            seconds,
            ..
        } = self;
        format!(
            "OcpResult(status='{status}', iterations={iterations}, kkt_residual={kkt_residual:.1e}, solver='{solver}', \
             seconds={seconds:.1e})"
        )
    }
}

#[doc = doc!(solve_ocp)]
#[pyfunction]
#[pyo3(signature = (A, B, c, x0, u_prev, reference, weights, bounds, *, solver = "riccati", guess = None,
    repeat = 1))]
#[allow(non_snake_case, clippy::too_many_arguments)] // the paper's symbols
pub fn solve_ocp<'py>(
    py: Python<'py>,
    A: ArrayLike<'py>,
    B: ArrayLike<'py>,
    c: ArrayLike<'py>,
    x0: Vector<'py>,
    u_prev: Vector<'py>,
    reference: ArrayLike<'py>,
    weights: &OcpWeights,
    bounds: &OcpBounds,
    solver: &str,
    guess: Option<Matrix<'py>>,
    repeat: u32,
) -> PyResult<OcpResult> {
    let arrays = Arrays {
        a: &A,
        b: &B,
        c: &c,
        x0: &x0,
        u_prev: &u_prev,
        reference: &reference,
        weights,
        bounds,
    };
    let mut qp = arrays.problem()?;
    scale_soft_rows(&mut qp);
    let kind = SolverKind::deserialize(solver.into_deserializer())
        .map_err(|error: Error| InvalidArgumentError::new_err(format!("solver: {error}")))?;
    let settings = SolverSettings {
        kind,
        ..SolverSettings::default()
    };
    let guess: Vec<Input> = match guess {
        None => Vec::new(),
        Some(guess) => rows::<NU>("guess", &guess)?
            .into_iter()
            .map(Input::from)
            .collect(),
    };
    if !guess.is_empty() && guess.len() != qp.horizon() {
        let expected = format!("({}, {NU})", qp.horizon());
        return Err(wrong_shape("guess", &expected, &[guess.len(), NU]));
    }
    if !guess.iter().flatten().all(|u| u.is_finite()) {
        return Err(InvalidArgumentError::new_err(
            "guess: expected finite numbers",
        ));
    }
    let mut solvers = solvers(&qp, &settings).map_err(raise)?;
    let mut solution = OcpSolution::new(qp.horizon());
    let (solver, seconds) = py.detach(|| {
        let (mut solver, mut seconds) = ("", f64::INFINITY);
        for _ in 0..repeat.max(1) {
            let start = Instant::now();
            solver = solve_with_fallback(
                &mut solvers,
                &qp,
                &guess,
                settings.kkt_tolerance,
                &mut solution,
            );
            seconds = seconds.min(start.elapsed().as_secs_f64());
        }
        (solver, seconds)
    });
    result(py, &solution, solver, seconds)
}

/// A solution as an object of Python.
pub fn result(
    py: Python<'_>,
    solution: &OcpSolution,
    solver: &'static str,
    seconds: f64,
) -> PyResult<OcpResult> {
    let flat = |rows: &mut dyn Iterator<Item = f64>| rows.collect::<Vec<_>>();
    let x = flat(&mut solution.x.iter().flat_map(|x| x.iter().copied()));
    let u = flat(&mut solution.u.iter().flat_map(|u| u.iter().copied()));
    Ok(OcpResult {
        status: status_name(egp_engine::status(solution.status)),
        x: array(py, x, [solution.x.len(), NX])?.unbind(),
        u: array(py, u, [solution.u.len(), NU])?.unbind(),
        iterations: solution.iterations,
        kkt_residual: solution.kkt.worst(),
        solver,
        seconds,
    })
}

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
