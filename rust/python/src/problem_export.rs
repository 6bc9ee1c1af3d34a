//! The optimal control problem of a control step as the arguments of `solve_ocp`.

use egp_core::qp::{SoftRow, Stage};
use egp_core::{NU, NX, OcpQp};
use pyo3::prelude::*;

use crate::array::{NewCube, NewMatrix, NewVector, OwnedArray, array, vector};
use crate::error::raise;
use crate::problem::{OcpBounds, OcpWeights};

/// `A`, `B`, `c`, `x0`, `u_prev`, `reference`, `weights` and `bounds`.
pub type Problem<'py> = (
    NewCube<'py>,
    NewCube<'py>,
    NewMatrix<'py>,
    NewVector<'py>,
    NewVector<'py>,
    NewMatrix<'py>,
    OcpWeights,
    OcpBounds,
);

/// The arguments with which `solve_ocp` gets this problem.
pub fn arguments<'py>(py: Python<'py>, qp: &OcpQp) -> PyResult<Problem<'py>> {
    let (horizon, n_soft) = (qp.horizon(), qp.n_soft());
    let all = |part: &dyn Fn(&Stage) -> Vec<f64>| qp.stages().iter().flat_map(part).collect();
    let owned = |shape: &[usize], part: &dyn Fn(&Stage) -> Vec<f64>| {
        OwnedArray::from_shape_vec(shape, all(part)).map_err(raise)
    };
    // nalgebra orders matrices by columns, numpy by rows.
    let a = all(&|stage| stage.a.transpose().as_slice().to_vec());
    let b = all(&|stage| stage.b.transpose().as_slice().to_vec());
    let inputs = [horizon, NU];
    let soft = |of: fn(&SoftRow) -> &[f64]| {
        move |stage: &Stage| stage.soft[..n_soft].iter().flat_map(of).copied().collect()
    };
    let weights = OcpWeights {
        q: owned(&[horizon, NX, NX], &|stage| stage.q.as_slice().to_vec())?,
        r: qp.r.into(),
        r_d: qp.r_d.into(),
        proximal: owned(&inputs, &|stage| stage.proximal.as_slice().to_vec())?,
        planned: owned(&inputs, &|stage| stage.planned.as_slice().to_vec())?,
    };
    let penalty = qp.penalty[..n_soft].iter();
    let bounds = OcpBounds {
        u_min: owned(&inputs, &|stage| stage.u_min.as_slice().to_vec())?,
        u_max: owned(&inputs, &|stage| stage.u_max.as_slice().to_vec())?,
        du_min: owned(&inputs, &|stage| stage.du_min.as_slice().to_vec())?,
        du_max: owned(&inputs, &|stage| stage.du_max.as_slice().to_vec())?,
        soft_normal: owned(&[horizon, n_soft, NX], &soft(|row| row.normal.as_slice()))?,
        soft_lower: owned(
            &[horizon, n_soft],
            &soft(|row| std::slice::from_ref(&row.lower)),
        )?,
        soft_upper: owned(
            &[horizon, n_soft],
            &soft(|row| std::slice::from_ref(&row.upper)),
        )?,
        penalty: penalty.map(|of| [of.linear, of.quadratic]).collect(),
    };
    Ok((
        array(py, a, [horizon, NX, NX])?,
        array(py, b, [horizon, NX, NU])?,
        array(py, all(&|stage| stage.c.as_slice().to_vec()), [horizon, NX])?,
        vector(py, qp.x0.iter().copied()),
        vector(py, qp.u_prev.iter().copied()),
        array(
            py,
            all(&|stage| stage.reference.as_slice().to_vec()),
            [horizon, NX],
        )?,
        weights,
        bounds,
    ))
}
