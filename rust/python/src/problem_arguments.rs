//! A linear time-varying optimal control problem from the arguments of `solve_ocp`.

use egp_core::qp::Penalty;
use egp_core::{Input, NU, NX, OcpQp, State};
use pyo3::prelude::*;

use crate::array::{ArrayLike, ArrayView, Vector, fixed, shown, wrong_shape};
use crate::error::InvalidArgumentError;
use crate::problem::{OcpBounds, OcpWeights};
use crate::problem_checks::{check_finite, check_order, check_stages};

/// The arguments of a problem, with the names of `solve_ocp`.
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
        if horizon == 0 {
            return Err(InvalidArgumentError::new_err(
                "A: expected at least one stage, got the shape (0, 7, 7)",
            ));
        }
        let stages = |name, array, shape: &[usize]| stages(name, array, horizon, shape);
        let a = stages("A", a, &[NX, NX])?;
        let b = stages("B", self.b.as_array(), &[NX, NU])?;
        let c = stages("c", self.c.as_array(), &[NX])?;
        let q = stages("q", weights.q.view(), &[NX, NX])?;
        let reference = stages("reference", self.reference.as_array(), &[NX])?;
        let proximal = stages("proximal", weights.proximal.view(), &[NU])?;
        let planned = stages("planned", weights.planned.view(), &[NU])?;
        let u_min = stages("u_min", bounds.u_min.view(), &[NU])?;
        let u_max = stages("u_max", bounds.u_max.view(), &[NU])?;
        let du_min = stages("du_min", bounds.du_min.view(), &[NU])?;
        let du_max = stages("du_max", bounds.du_max.view(), &[NU])?;
        let normal = stages("soft_normal", bounds.soft_normal.view(), &[n_soft, NX])?;
        let lower = stages("soft_lower", bounds.soft_lower.view(), &[n_soft])?;
        let upper = stages("soft_upper", bounds.soft_upper.view(), &[n_soft])?;
        check_order(["u_min", "u_max"], [&u_min, &u_max], NU)?;
        check_order(["du_min", "du_max"], [&du_min, &du_max], NU)?;
        check_order(["soft_lower", "soft_upper"], [&lower, &upper], n_soft)?;

        let mut qp = OcpQp::new(horizon, n_soft);
        qp.x0 = fixed::<NX>("x0", self.x0)?.into();
        qp.u_prev = fixed::<NU>("u_prev", self.u_prev)?.into();
        check_finite("x0", self.x0.as_array().into_dyn())?;
        check_finite("u_prev", self.u_prev.as_array().into_dyn())?;
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
            stage.proximal = Input::from_row_slice(part(&proximal, t, NU));
            stage.planned = Input::from_row_slice(part(&planned, t, NU));
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
        check_stages(&qp)?;
        Ok(qp)
    }
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
    let numbers = array.iter().copied().collect::<Vec<_>>().repeat(repeats);
    check_finite(name, array)?;
    Ok(numbers)
}

/// The `index`-th of parts with `size` numbers.
fn part(values: &[f64], index: usize, size: usize) -> &[f64] {
    &values[index * size..][..size]
}
