//! The QP of a step and the weights' QP by themselves, for comparison with other solvers.

use std::time::Instant;

use egp_core::qp::{Csc, MAX_SOFT, SparseQp};
use egp_core::settings::{Penalty, Prior, SolverKind, SolverSettings};
use egp_core::solver::{rungs, solve_first};
use egp_core::weights::WeightEstimator;
use egp_core::{GpOutput, Input, NU, NX, NY, OcpQp, OcpSolution, Status};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{Cube, KeptMatrix, Matrix, NewVector, Vector};
use crate::array::{array, fixed, layers, rows, vector, wrong_shape};
use crate::error::{EgpError, raise};

/// Values, row indices and column starts of a sparse matrix.
type Sparse<'py> = (NewVector<'py>, NewVector<'py, i64>, NewVector<'py, i64>);
/// `P` (upper triangle), `q`, `A`, `l`, `u`.
type SparseProblem<'py> = (
    Sparse<'py>,
    NewVector<'py>,
    Sparse<'py>,
    NewVector<'py>,
    NewVector<'py>,
);

/// The arrays of a problem by name.
struct Fields<'a, 'py>(&'a Bound<'py, PyDict>);

impl<'py> Fields<'_, 'py> {
    fn get<T: for<'a> FromPyObject<'a, 'py>>(&self, name: &str) -> PyResult<T> {
        let Some(value) = self.0.get_item(name)? else {
            return Err(EgpError::new_err(format!("problem lacks {name:?}")));
        };
        value.extract().map_err(|_| {
            EgpError::new_err(format!("{name:?} must be a float64 array of its dimension"))
        })
    }

    fn vector<const N: usize>(&self, name: &str) -> PyResult<[f64; N]> {
        fixed(name, &self.get::<Vector<'py>>(name)?)
    }

    fn rows<const N: usize>(&self, name: &str, count: usize) -> PyResult<Vec<[f64; N]>> {
        let rows = rows(name, &self.get::<Matrix<'py>>(name)?)?;
        if rows.len() == count {
            return Ok(rows);
        }
        Err(wrong_shape(
            name,
            &format!("({count}, {N})"),
            &[rows.len(), N],
        ))
    }

    fn layers<const R: usize, const C: usize>(
        &self,
        name: &str,
        count: usize,
    ) -> PyResult<Vec<[[f64; C]; R]>> {
        let layers = layers(name, &self.get::<Cube<'py>>(name)?)?;
        if layers.len() == count {
            return Ok(layers);
        }
        Err(wrong_shape(
            name,
            &format!("({count}, {R}, {C})"),
            &[layers.len(), R, C],
        ))
    }
}

/// The problem that the arrays describe.
fn read(problem: &Bound<'_, PyDict>) -> PyResult<OcpQp> {
    let fields = Fields(problem);
    let horizon = fields.get::<Matrix<'_>>("c")?.as_array().nrows();
    let soft_rows = fields.get::<Matrix<'_>>("penalty")?.as_array().nrows();
    let mut qp = OcpQp::new(horizon, soft_rows);
    qp.x0 = fields.vector::<NX>("x0")?.into();
    qp.u_prev = fields.vector::<NU>("u_prev")?.into();
    qp.r = fields.vector::<NU>("r")?.into();
    qp.r_d = fields.vector::<NU>("r_d")?.into();
    let penalty = fields.rows::<2>("penalty", soft_rows.min(MAX_SOFT))?;
    for (to, [linear, quadratic]) in qp.penalty.iter_mut().zip(penalty) {
        *to = Penalty { linear, quadratic };
    }
    let a = fields.layers::<NX, NX>("a", horizon)?;
    let b = fields.layers::<NX, NU>("b", horizon)?;
    let q = fields.layers::<NX, NX>("q", horizon)?;
    let c = fields.rows::<NX>("c", horizon)?;
    let reference = fields.rows::<NX>("reference", horizon)?;
    let u_min = fields.rows::<NU>("u_min", horizon)?;
    let u_max = fields.rows::<NU>("u_max", horizon)?;
    let du_min = fields.rows::<NU>("du_min", horizon)?;
    let du_max = fields.rows::<NU>("du_max", horizon)?;
    let normal = fields.layers::<MAX_SOFT, NX>("soft_normal", horizon)?;
    let lower = fields.rows::<MAX_SOFT>("soft_lower", horizon)?;
    let upper = fields.rows::<MAX_SOFT>("soft_upper", horizon)?;
    for (t, stage) in qp.stages_mut().iter_mut().enumerate() {
        for i in 0..NX {
            for j in 0..NX {
                (stage.a[(i, j)], stage.q[(i, j)]) = (a[t][i][j], q[t][i][j]);
            }
            for (j, &value) in b[t][i].iter().enumerate() {
                stage.b[(i, j)] = value;
            }
        }
        (stage.c, stage.reference) = (c[t].into(), reference[t].into());
        (stage.u_min, stage.u_max) = (u_min[t].into(), u_max[t].into());
        (stage.du_min, stage.du_max) = (du_min[t].into(), du_max[t].into());
        for (j, row) in stage.soft.iter_mut().enumerate() {
            row.normal = normal[t][j].into();
            (row.lower, row.upper) = (lower[t][j], upper[t][j]);
        }
    }
    if horizon > 0 && qp.is_well_posed() && qp.keeps_pattern() {
        return Ok(qp);
    }
    Err(EgpError::new_err(
        "expected at least one stage, finite numbers, lower <= upper, symmetric q, and entries only \
         where the vehicle's equations have them",
    ))
}

fn sparse<'py>(py: Python<'py>, matrix: &Csc) -> Sparse<'py> {
    // Indices of matrices that fit into memory fit into i64.
    #[allow(clippy::cast_possible_wrap)]
    let indices = |of: &[usize]| vector(py, of.iter().map(|&index| index as i64));
    (
        vector(py, matrix.values.iter().copied()),
        indices(&matrix.row_index),
        indices(&matrix.column_start),
    )
}

#[pyfunction]
fn ocp_to_qp<'py>(py: Python<'py>, problem: &Bound<'py, PyDict>) -> PyResult<SparseProblem<'py>> {
    let qp = SparseQp::new(&read(problem)?);
    Ok((
        sparse(py, &qp.p),
        vector(py, qp.q.iter().copied()),
        sparse(py, &qp.a),
        vector(py, qp.l.iter().copied()),
        vector(py, qp.u.iter().copied()),
    ))
}

/// What became of an optimal control problem.
#[pyclass(frozen, get_all, module = "egp_service._core")]
pub struct OcpResult {
    /// "solved", "iteration limit", "infeasible", "numerical error" or "check failed".
    status: &'static str,
    /// States, `(T+1, 7)`.
    x: KeptMatrix,
    /// Scaled inputs, `(T, 2)`.
    u: KeptMatrix,
    /// Iterations of the solver that had the last word.
    iterations: u32,
    /// Largest residual of the optimality conditions.
    kkt_residual: f64,
    /// The solver that had the last word.
    solver: &'static str,
    /// Shortest time of all repetitions in s, check included, Python excluded.
    seconds: f64,
}

#[pyfunction]
#[pyo3(signature = (problem, solver = "riccati", guess = None, repeat = 1))]
fn solve_ocp<'py>(
    py: Python<'py>,
    problem: &Bound<'py, PyDict>,
    solver: &str,
    guess: Option<Matrix<'py>>,
    repeat: u32,
) -> PyResult<OcpResult> {
    let qp = read(problem)?;
    let kind = match solver {
        "riccati" => SolverKind::Riccati,
        "clarabel" => SolverKind::Clarabel,
        other => {
            return Err(EgpError::new_err(format!(
                "solver must be \"riccati\" or \"clarabel\", got {other:?}"
            )));
        }
    };
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
    let mut rungs = rungs(&qp, &settings).map_err(raise)?;
    let mut solution = OcpSolution::new(qp.horizon());
    let (solver, seconds) = py.detach(|| {
        let (mut solver, mut seconds) = ("", f64::INFINITY);
        for _ in 0..repeat.max(1) {
            let start = Instant::now();
            solver = solve_first(
                &mut rungs,
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

/// A solution as Python sees it.
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
        status: name(solution.status),
        x: array(py, x, [solution.x.len(), NX])?.unbind(),
        u: array(py, u, [solution.u.len(), NU])?.unbind(),
        iterations: solution.iterations,
        kkt_residual: solution.kkt.worst(),
        solver,
        seconds,
    })
}

fn name(status: Status) -> &'static str {
    match status {
        Status::Solved => "solved",
        Status::IterationLimit => "iteration limit",
        Status::Infeasible => "infeasible",
        Status::NumericalError => "numerical error",
        Status::CheckFailed => "check failed",
    }
}

#[pyfunction]
fn solve_weights<'py>(
    py: Python<'py>,
    predictions: Cube<'py>,
    measured: Matrix<'py>,
    noise_std: Vector<'py>,
    previous: Vector<'py>,
    prior: &str,
    strength: f64,
) -> PyResult<NewVector<'py>> {
    let measured = rows::<NY>("measured", &measured)?;
    let noise = GpOutput::from(fixed::<NY>("noise_std", &noise_std)?);
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
    let prior = match prior {
        "quadratic" => Prior::Quadratic { lambda: strength },
        "l1" => Prior::L1 { alpha: strength },
        other => {
            return Err(EgpError::new_err(format!(
                "prior must be \"quadratic\" or \"l1\", got {other:?}"
            )));
        }
    };
    let predictions: Vec<f64> = predictions.as_array().iter().copied().collect();
    let numbers = predictions.iter().chain(measured.as_flattened());
    let sum: f64 = previous.iter().sum();
    let sensible = numbers.chain(&previous).all(|v| v.is_finite())
        && noise.iter().all(|std| *std > 0.0)
        && (0.0..=f64::MAX).contains(&strength)
        && previous.iter().all(|w| *w >= 0.0)
        && (sum - 1.0).abs() <= 1e-9;
    if !sensible {
        return Err(EgpError::new_err(
            "expected finite numbers, positive noise_std, strength >= 0 and previous weights on the simplex",
        ));
    }
    let mut w = vec![0.0; previous.len()];
    py.detach(|| {
        let inverse_noise = noise.map(|std| 1.0 / std);
        WeightEstimator::new(previous.len()).estimate(
            &predictions,
            &measured,
            &inverse_noise,
            prior,
            &previous,
            &mut w,
        )
    });
    Ok(vector(py, w))
}

/// Adds the functions to the module.
///
/// # Errors
/// When Python refuses an attribute.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<OcpResult>()?;
    module.add_function(wrap_pyfunction!(ocp_to_qp, module)?)?;
    module.add_function(wrap_pyfunction!(solve_ocp, module)?)?;
    module.add_function(wrap_pyfunction!(solve_weights, module)?)
}
