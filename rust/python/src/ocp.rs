//! The QP of a step by itself, for comparison with other solvers.

use std::time::Instant;

use egp_core::qp::{Csc, Multipliers, SOFT_PATTERN, SparseQp};
use egp_core::settings::{SolverKind, SolverSettings};
use egp_core::solver::{solve_with_fallback, solvers};
use egp_core::{Input, NU, NX, OcpQp, OcpSolution};
use egp_wire::status_name;
use pyo3::prelude::*;
use serde::Deserialize as _;
use serde::de::IntoDeserializer as _;
use serde::de::value::Error;

use crate::array::{ArrayLike, KeptMatrix, Matrix, NewVector, Vector};
use crate::array::{array, row_count, rows, vector, wrong_shape};
use crate::error::{InvalidArgumentError, raise};
use crate::problem::{OcpBounds, OcpWeights};
use crate::problem_arguments::Arrays;

#[doc = doc!(OcpResult)]
#[pyclass(frozen, get_all, module = "egp_service._core")]
pub struct OcpResult {
    #[doc = doc!(OcpResult.status)]
    status: &'static str,
    #[doc = doc!(OcpResult.x)]
    x: KeptMatrix,
    #[doc = doc!(OcpResult.u)]
    u: KeptMatrix,
    #[doc = doc!(OcpResult.cost)]
    cost: f64,
    #[doc = doc!(OcpResult.multipliers)]
    multipliers: Py<OcpMultipliers>,
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
            cost,
            iterations,
            kkt_residual,
            solver,
            seconds,
            ..
        } = self;
        format!(
            "OcpResult(status='{status}', cost={cost:.6}, iterations={iterations}, kkt_residual={kkt_residual:.1e}, solver='{solver}', \
             seconds={seconds:.1e})"
        )
    }
}

#[doc = doc!(OcpMultipliers)]
#[pyclass(frozen, get_all, module = "egp_service._core")]
pub struct OcpMultipliers {
    #[doc = doc!(OcpMultipliers.u_min)]
    u_min: KeptMatrix,
    #[doc = doc!(OcpMultipliers.u_max)]
    u_max: KeptMatrix,
    #[doc = doc!(OcpMultipliers.du_min)]
    du_min: KeptMatrix,
    #[doc = doc!(OcpMultipliers.du_max)]
    du_max: KeptMatrix,
    #[doc = doc!(OcpMultipliers.soft_lower)]
    soft_lower: KeptMatrix,
    #[doc = doc!(OcpMultipliers.soft_upper)]
    soft_upper: KeptMatrix,
}

#[pymethods]
impl OcpMultipliers {
    fn __repr__(&self, py: Python<'_>) -> String {
        let horizon = row_count(py, &self.u_min);
        format!("OcpMultipliers(stages={horizon})")
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
    let stated = arrays.problem()?;
    let mut qp = stated.clone();
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
    let flat = |rows: &mut dyn Iterator<Item = f64>| rows.collect::<Vec<_>>();
    let x = flat(&mut solution.x.iter().flat_map(|x| x.iter().copied()));
    let u = flat(&mut solution.u.iter().flat_map(|u| u.iter().copied()));
    for (t, multipliers) in solution.multipliers.iter_mut().enumerate() {
        unscale(multipliers, &stated, &qp, t);
    }
    Ok(OcpResult {
        status: status_name(egp_engine::status(solution.status)),
        x: array(py, x, [solution.x.len(), NX])?.unbind(),
        u: array(py, u, [solution.u.len(), NU])?.unbind(),
        cost: solution.cost,
        multipliers: Py::new(py, multipliers(py, &solution, qp.n_soft())?)?,
        iterations: solution.iterations,
        kkt_residual: solution.kkt.worst(),
        solver,
        seconds,
    })
}

/// The multipliers of a solution as arrays, of which those of soft rows have `n_soft` columns.
fn multipliers(py: Python<'_>, solution: &OcpSolution, n_soft: usize) -> PyResult<OcpMultipliers> {
    let columns = |width: usize, of: &dyn Fn(&Multipliers) -> &[f64]| {
        let stages = solution.multipliers.iter();
        let values = stages.flat_map(|stage| of(stage)[..width].iter().copied());
        let made = array(py, values.collect(), [solution.multipliers.len(), width])?;
        PyResult::Ok(made.unbind())
    };
    Ok(OcpMultipliers {
        u_min: columns(NU, &|of| of.u_lower.as_slice())?,
        u_max: columns(NU, &|of| of.u_upper.as_slice())?,
        du_min: columns(NU, &|of| of.du_lower.as_slice())?,
        du_max: columns(NU, &|of| of.du_upper.as_slice())?,
        soft_lower: columns(n_soft, &|of| &of.soft_lower)?,
        soft_upper: columns(n_soft, &|of| &of.soft_upper)?,
    })
}

/// Gives soft rows on one state the normal 1, which the default solver assumes, with bounds and penalty of the same
/// problem. A row whose normal has different magnitudes at the stages keeps them, because it has only one penalty.
fn scale_soft_rows(qp: &mut OcpQp) {
    for (j, pattern) in SOFT_PATTERN.iter().enumerate().take(qp.n_soft()) {
        let &[state] = *pattern else { continue };
        let normals = || {
            qp.stages()
                .iter()
                .map(|stage| stage.soft[j].normal[state].abs())
        };
        let size = normals().fold(0.0, f64::max);
        let other = normals().any(|normal| normal != 0.0 && normal != size);
        if other || !(1e-6..=1e6).contains(&size) {
            continue;
        }
        for row in qp.stages_mut().iter_mut().map(|stage| &mut stage.soft[j]) {
            let normal = row.normal[state];
            if normal != 0.0 && normal != 1.0 {
                let ends = [row.lower / normal, row.upper / normal];
                (row.lower, row.upper) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
                row.normal[state] = 1.0;
            }
        }
        qp.penalty[j].linear *= size;
        qp.penalty[j].quadratic *= size * size;
    }
}

/// Changes the multipliers of a stage from those of the scaled soft rows to those of the stated ones.
fn unscale(multipliers: &mut Multipliers, stated: &OcpQp, scaled: &OcpQp, t: usize) {
    for (j, pattern) in SOFT_PATTERN.iter().enumerate().take(stated.n_soft()) {
        let &[state] = *pattern else { continue };
        let normal = |qp: &OcpQp| qp.stages()[t].soft[j].normal[state];
        if normal(stated) == normal(scaled) {
            continue;
        }
        let factor = normal(scaled) / normal(stated);
        let (lower, upper) = (
            &mut multipliers.soft_lower[j],
            &mut multipliers.soft_upper[j],
        );
        if factor < 0.0 {
            std::mem::swap(lower, upper);
        }
        *lower *= factor.abs();
        *upper *= factor.abs();
    }
}

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

#[doc = doc!(ocp_to_qp)]
#[pyfunction]
#[pyo3(signature = (A, B, c, x0, u_prev, reference, weights, bounds))]
#[allow(non_snake_case, clippy::too_many_arguments)] // the paper's symbols
pub fn ocp_to_qp<'py>(
    py: Python<'py>,
    A: ArrayLike<'py>,
    B: ArrayLike<'py>,
    c: ArrayLike<'py>,
    x0: Vector<'py>,
    u_prev: Vector<'py>,
    reference: ArrayLike<'py>,
    weights: &OcpWeights,
    bounds: &OcpBounds,
) -> PyResult<SparseProblem<'py>> {
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
    let qp = SparseQp::new(&arrays.problem()?);
    Ok((
        sparse(py, &qp.p),
        vector(py, qp.q.iter().copied()),
        sparse(py, &qp.a),
        vector(py, qp.l.iter().copied()),
        vector(py, qp.u.iter().copied()),
    ))
}
