//! Cost and bounds of a linear time-varying optimal control problem.
//!
//! An array that has no axis for the stages holds for all of them.

use egp_core::qp::MAX_SOFT;
use egp_core::{NU, NX};
use pyo3::prelude::*;

use crate::array::{
    ArrayLike, Matrix, NewArray, NewMatrix, NewVector, OwnedArray, Vector, array, copied, fixed,
    rows, shown, vector, wrong_shape,
};
use crate::error::InvalidArgumentError;

#[doc = doc!(OcpWeights)]
#[pyclass(frozen, module = "egp_service._core")]
pub struct OcpWeights {
    pub q: OwnedArray,
    pub r: [f64; NU],
    pub r_d: [f64; NU],
    pub proximal: OwnedArray,
    pub planned: OwnedArray,
}

#[pymethods]
impl OcpWeights {
    #[new]
    #[pyo3(signature = (*, q, r, r_d, proximal = None, planned = None))]
    fn new(
        q: ArrayLike<'_>,
        r: Vector<'_>,
        r_d: Vector<'_>,
        proximal: Option<ArrayLike<'_>>,
        planned: Option<ArrayLike<'_>>,
    ) -> PyResult<Self> {
        let diagonals = [fixed("r", &r)?, fixed("r_d", &r_d)?];
        let [r, r_d] = diagonals;
        let allowed = |r: &f64| r.is_finite() && *r >= 0.0;
        if r.iter().all(|r| *r > 0.0) && diagonals.as_flattened().iter().all(allowed) {
            return Ok(Self {
                q: owned(&q),
                r,
                r_d,
                proximal: owned_or_zeros(proximal, &[NU]),
                planned: owned_or_zeros(planned, &[NU]),
            });
        }
        Err(InvalidArgumentError::new_err(format!(
            "expected finite r > 0, which keeps the solution unique, and r_d >= 0, got {r:?} and {r_d:?}"
        )))
    }

    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> NewArray<'py> {
        copied(py, &self.q)
    }

    #[getter]
    fn r<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.r)
    }

    #[getter]
    fn r_d<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.r_d)
    }

    #[getter]
    fn proximal<'py>(&self, py: Python<'py>) -> NewArray<'py> {
        copied(py, &self.proximal)
    }

    #[getter]
    fn planned<'py>(&self, py: Python<'py>) -> NewArray<'py> {
        copied(py, &self.planned)
    }

    fn __repr__(&self) -> String {
        let Self { q, r, r_d, .. } = self;
        let q = shown(q.shape());
        format!("OcpWeights(q of shape {q}, r={r:?}, r_d={r_d:?})")
    }
}

#[doc = doc!(OcpBounds)]
#[pyclass(frozen, module = "egp_service._core")]
pub struct OcpBounds {
    pub u_min: OwnedArray,
    pub u_max: OwnedArray,
    pub du_min: OwnedArray,
    pub du_max: OwnedArray,
    pub soft_normal: OwnedArray,
    pub soft_lower: OwnedArray,
    pub soft_upper: OwnedArray,
    pub penalty: Vec<[f64; 2]>,
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
        Ok(Self {
            u_min: owned(&u_min),
            u_max: owned(&u_max),
            du_min: owned(&du_min),
            du_max: owned(&du_max),
            soft_normal: owned_or_zeros(soft_normal, &[0, NX]),
            soft_lower: owned_or_zeros(soft_lower, &[0]),
            soft_upper: owned_or_zeros(soft_upper, &[0]),
            penalty,
        })
    }

    #[getter]
    fn u_min<'py>(&self, py: Python<'py>) -> NewArray<'py> {
        copied(py, &self.u_min)
    }

    #[getter]
    fn u_max<'py>(&self, py: Python<'py>) -> NewArray<'py> {
        copied(py, &self.u_max)
    }

    #[getter]
    fn du_min<'py>(&self, py: Python<'py>) -> NewArray<'py> {
        copied(py, &self.du_min)
    }

    #[getter]
    fn du_max<'py>(&self, py: Python<'py>) -> NewArray<'py> {
        copied(py, &self.du_max)
    }

    #[getter]
    fn soft_normal<'py>(&self, py: Python<'py>) -> NewArray<'py> {
        copied(py, &self.soft_normal)
    }

    #[getter]
    fn soft_lower<'py>(&self, py: Python<'py>) -> NewArray<'py> {
        copied(py, &self.soft_lower)
    }

    #[getter]
    fn soft_upper<'py>(&self, py: Python<'py>) -> NewArray<'py> {
        copied(py, &self.soft_upper)
    }

    #[getter]
    fn penalty<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        array(
            py,
            self.penalty.as_flattened().to_vec(),
            [self.penalty.len(), 2],
        )
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

fn owned(array: &ArrayLike<'_>) -> OwnedArray {
    array.as_array().to_owned()
}

/// The array, or zeros of this shape in its place.
fn owned_or_zeros(array: Option<ArrayLike<'_>>, shape: &[usize]) -> OwnedArray {
    array.map_or_else(|| OwnedArray::zeros(shape), |array| owned(&array))
}
