//! A linear time-varying optimal control problem from arrays.
//!
//! An array that has no axis for the stages holds for all of them.

use egp_core::qp::{MAX_SOFT, Penalty, SOFT_PATTERN};
use egp_core::{Input, NU, NX, OcpQp, State};
use pyo3::prelude::*;

use crate::array::{
    ArrayLike, ArrayView, Matrix, OwnedArray, Vector, fixed, rows, shown, wrong_shape,
};
use crate::error::InvalidArgumentError;

#[doc = doc!(OcpWeights)]
#[pyclass(frozen, module = "egp_service._core")]
pub struct OcpWeights {
    q: OwnedArray,
    r: [f64; NU],
    r_d: [f64; NU],
}

#[pymethods]
impl OcpWeights {
    #[new]
    #[pyo3(signature = (*, q, r, r_d))]
    fn new(q: ArrayLike<'_>, r: Vector<'_>, r_d: Vector<'_>) -> PyResult<Self> {
        let diagonals = [fixed("r", &r)?, fixed("r_d", &r_d)?];
        let [r, r_d] = diagonals;
        let allowed = |r: &f64| r.is_finite() && *r >= 0.0;
        if r.iter().all(|r| *r > 0.0) && diagonals.as_flattened().iter().all(allowed) {
            return Ok(Self {
                q: owned(&q),
                r,
                r_d,
            });
        }
        Err(InvalidArgumentError::new_err(format!(
            "expected finite r > 0, which keeps the solution unique, and r_d >= 0, got {r:?} and {r_d:?}"
        )))
    }

    fn __repr__(&self) -> String {
        let Self { q, r, r_d } = self;
        let q = shown(q.shape());
        format!("OcpWeights(q of shape {q}, r={r:?}, r_d={r_d:?})")
    }
}

#[doc = doc!(OcpBounds)]
#[pyclass(frozen, module = "egp_service._core")]
pub struct OcpBounds {
    u_min: OwnedArray,
    u_max: OwnedArray,
    du_min: OwnedArray,
    du_max: OwnedArray,
    soft_normal: OwnedArray,
    soft_lower: OwnedArray,
    soft_upper: OwnedArray,
    penalty: Vec<[f64; 2]>,
}

#[pymethods]
impl OcpBounds {
    #[new]
    #[pyo3(signature = (*, u_min, u_max, du_min, du_max, soft_normal = None, soft_lower = None, soft_upper = None,
        penalty = None))]
    #[allow(clippy::too_many_arguments)] // all by name
    fn new(
        u_min: ArrayLike<'_>,
        u_max: ArrayLike<'_>,
        du_min: ArrayLike<'_>,
        du_max: ArrayLike<'_>,
        soft_normal: Option<ArrayLike<'_>>,
        soft_lower: Option<ArrayLike<'_>>,
        soft_upper: Option<ArrayLike<'_>>,
        penalty: Option<Matrix<'_>>,
    ) -> PyResult<Self> {
        let penalty =
            penalty.map_or_else(|| Ok(Vec::new()), |penalty| rows("penalty", &penalty))?;
        if penalty.len() > MAX_SOFT {
            let expected = format!("(n, 2) with n <= {MAX_SOFT}");
            return Err(wrong_shape("penalty", &expected, &[penalty.len(), 2]));
        }
        if !penalty
            .as_flattened()
            .iter()
            .all(|price| price.is_finite() && *price > 0.0)
        {
            return Err(InvalidArgumentError::new_err(format!(
                "expected finite penalty > 0, got {penalty:?}"
            )));
        }
        let rows_of = |array: Option<ArrayLike<'_>>, none: &[usize]| {
            array.map_or_else(|| OwnedArray::zeros(none), |array| owned(&array))
        };
        Ok(Self {
            u_min: owned(&u_min),
            u_max: owned(&u_max),
            du_min: owned(&du_min),
            du_max: owned(&du_max),
            soft_normal: rows_of(soft_normal, &[0, NX]),
            soft_lower: rows_of(soft_lower, &[0]),
            soft_upper: rows_of(soft_upper, &[0]),
            penalty,
        })
    }

    fn __repr__(&self) -> String {
        let [u_min, u_max, du_min, du_max] = [&self.u_min, &self.u_max, &self.du_min, &self.du_max]
            .map(|bound| shown(bound.shape()));
        let soft = self.penalty.len();
        format!(
            "OcpBounds(u_min of shape {u_min}, u_max {u_max}, du_min {du_min}, du_max {du_max}, soft rows: {soft})"
        )
    }
}

/// The arguments of a problem.
pub struct Arrays<'a, 'py> {
    pub a: &'a ArrayLike<'py>,
    pub b: &'a ArrayLike<'py>,
    pub c: &'a ArrayLike<'py>,
    pub x0: &'a Vector<'py>,
    pub u_prev: &'a Vector<'py>,
    pub reference: &'a ArrayLike<'py>,
    pub weights: &'a OcpWeights,
    pub bounds: &'a OcpBounds,
}

impl Arrays<'_, '_> {
    /// The problem that the arrays describe; the first axis of `A` is the horizon.
    ///
    /// # Errors
    /// Errors if a shape is wrong, a number is not finite, bounds cross, or an entry lies outside the pattern.
    pub fn problem(&self) -> PyResult<OcpQp> {
        let a = self.a.as_array();
        let &[horizon, NX, NX] = a.shape() else {
            return Err(wrong_shape("A", "(T, 7, 7)", a.shape()));
        };
        let (weights, bounds) = (self.weights, self.bounds);
        let n_soft = bounds.penalty.len();
        let stages = |name, array, shape: &[usize]| stages(name, array, horizon, shape);
        let a = stages("A", a, &[NX, NX])?;
        let b = stages("B", self.b.as_array(), &[NX, NU])?;
        let c = stages("c", self.c.as_array(), &[NX])?;
        let q = stages("q", weights.q.view(), &[NX, NX])?;
        let reference = stages("reference", self.reference.as_array(), &[NX])?;
        let u_min = stages("u_min", bounds.u_min.view(), &[NU])?;
        let u_max = stages("u_max", bounds.u_max.view(), &[NU])?;
        let du_min = stages("du_min", bounds.du_min.view(), &[NU])?;
        let du_max = stages("du_max", bounds.du_max.view(), &[NU])?;
        let normal = stages("soft_normal", bounds.soft_normal.view(), &[n_soft, NX])?;
        let lower = stages("soft_lower", bounds.soft_lower.view(), &[n_soft])?;
        let upper = stages("soft_upper", bounds.soft_upper.view(), &[n_soft])?;

        let mut qp = OcpQp::new(horizon, n_soft);
        qp.x0 = fixed::<NX>("x0", self.x0)?.into();
        qp.u_prev = fixed::<NU>("u_prev", self.u_prev)?.into();
        (qp.r, qp.r_d) = (weights.r.into(), weights.r_d.into());
        for (to, &[linear, quadratic]) in qp.penalty.iter_mut().zip(&bounds.penalty) {
            *to = Penalty { linear, quadratic };
        }
        for (t, stage) in qp.stages_mut().iter_mut().enumerate() {
            for k in 0..NX * NX {
                let entry = (k / NX, k % NX);
                (stage.a[entry], stage.q[entry]) = (a[t * NX * NX + k], q[t * NX * NX + k]);
            }
            for k in 0..NX * NU {
                stage.b[(k / NU, k % NU)] = b[t * NX * NU + k];
            }
            stage.c = State::from_row_slice(part(&c, t, NX));
            stage.reference = State::from_row_slice(part(&reference, t, NX));
            stage.u_min = Input::from_row_slice(part(&u_min, t, NU));
            stage.u_max = Input::from_row_slice(part(&u_max, t, NU));
            stage.du_min = Input::from_row_slice(part(&du_min, t, NU));
            stage.du_max = Input::from_row_slice(part(&du_max, t, NU));
            for (j, row) in stage.soft[..n_soft].iter_mut().enumerate() {
                let at = t * n_soft + j;
                row.normal = State::from_row_slice(part(&normal, at, NX));
                (row.lower, row.upper) = (lower[at], upper[at]);
            }
        }
        if horizon == 0 || !qp.is_well_posed() {
            return Err(InvalidArgumentError::new_err(
                "expected at least one stage, finite numbers, and lower bounds that are not above the upper ones",
            ));
        }
        // q has only the position block and a diagonal, so these conditions suffice.
        let convex = qp.stages().iter().map(|stage| &stage.q).all(|q| {
            q.diagonal().min() >= 0.0 && q[(0, 1)].powi(2) <= q[(0, 0)] * q[(1, 1)] * (1.0 + 1e-12)
        });
        if !convex {
            return Err(InvalidArgumentError::new_err(
                "expected positive semidefinite q, so that a minimum exists",
            ));
        }
        if qp.keeps_pattern() {
            return Ok(qp);
        }
        Err(InvalidArgumentError::new_err(
            "expected symmetric q, and entries of A, B, q and soft_normal only where the documentation of solve_ocp \
             lists them",
        ))
    }
}

/// Gives soft rows on one state the normal 1, which the default solver assumes, with bounds and penalty of the same
/// problem. A row whose normal has different magnitudes at the stages keeps them, because it has only one penalty.
pub fn scale_soft_rows(qp: &mut OcpQp) {
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

fn owned(array: &ArrayLike<'_>) -> OwnedArray {
    array.as_array().to_owned()
}

/// The numbers of all stages in row-major order; `shape` is that of one stage.
fn stages(name: &str, array: ArrayView<'_>, horizon: usize, shape: &[usize]) -> PyResult<Vec<f64>> {
    let full = [&[horizon], shape].concat();
    let repeats = match array.shape() {
        found if found == full => 1,
        found if found == shape => horizon,
        found => {
            let expected = format!("{} or {}", shown(&full), shown(shape));
            return Err(wrong_shape(name, &expected, found));
        }
    };
    Ok(array.iter().copied().collect::<Vec<_>>().repeat(repeats))
}

/// The `index`-th of parts with `size` numbers.
fn part(values: &[f64], index: usize, size: usize) -> &[f64] {
    &values[index * size..][..size]
}
