//! Errors about the numbers of an optimal control problem, with the name of the argument and the place of the number.

use egp_core::qp::{A_PATTERN, B_PATTERN, Q_PATTERN, SOFT_PATTERN, Stage};
use egp_core::{NU, NX, OcpQp};
use pyo3::prelude::*;

use crate::array::{ArrayView, not_finite};
use crate::error::InvalidArgumentError;

/// Errors unless all numbers of an array are finite.
pub fn check_finite(name: &str, array: ArrayView<'_>) -> PyResult<()> {
    match not_finite(array) {
        None => Ok(()),
        Some((index, number)) => Err(wrong(format!(
            "{name}{index:?}: expected a finite number, got {number}"
        ))),
    }
}

/// Errors if a lower bound is above its upper bound; each stage has `width` of both.
pub fn check_order(names: [&str; 2], bounds: [&[f64]; 2], width: usize) -> PyResult<()> {
    let mut pairs = bounds[0].iter().zip(bounds[1]);
    match pairs.position(|(lower, upper)| lower > upper) {
        None => Ok(()),
        Some(at) => {
            let ([low, high], [lower, upper]) = (names, bounds);
            Err(wrong(format!(
                "stage {}: expected {low} of at most {high}, got {low}[{i}] = {} and {high}[{i}] = {}",
                at / width,
                lower[at],
                upper[at],
                i = at % width
            )))
        }
    }
}

/// Errors unless the cost is convex and all entries are where the solvers expect them.
pub fn check_stages(qp: &OcpQp) -> PyResult<()> {
    for (t, stage) in qp.stages().iter().enumerate() {
        if let Some(problem) = problem(stage, qp.n_soft()) {
            return Err(wrong(format!("stage {t}: {problem}")));
        }
    }
    Ok(())
}

/// What is wrong with a stage, if anything.
fn problem(stage: &Stage, n_soft: usize) -> Option<String> {
    let Stage { a, b, q, .. } = stage;
    if let Some(k) = (0..NX * NX).find(|k| q[(k / NX, k % NX)] != q[(k % NX, k / NX)]) {
        let (i, j) = (k / NX, k % NX);
        return Some(format!(
            "expected symmetric q, got q[{i}, {j}] = {} and q[{j}, {i}] = {}",
            q[(i, j)],
            q[(j, i)]
        ));
    }
    let of_q = |i: usize| {
        let entries = Q_PATTERN.iter();
        let other = entries.filter_map(move |&(row, column)| match i {
            _ if row == i => Some(column),
            _ if column == i => Some(row),
            _ => None,
        });
        other.collect::<Vec<_>>()
    };
    let outside = |name: &str, i: usize, row: &[f64], pattern: &[usize]| {
        let wrong = |(j, number): (usize, &f64)| *number != 0.0 && !pattern.contains(&j);
        let j = row.iter().enumerate().position(wrong)?;
        Some(format!(
            "expected {name}[{i}, {j}] = 0, got {}: row {i} of {name} may only have entries at the columns {pattern:?}",
            row[j]
        ))
    };
    let row = |i: usize| {
        outside(
            "A",
            i,
            &(0..NX).map(|j| a[(i, j)]).collect::<Vec<_>>(),
            A_PATTERN[i],
        )
        .or_else(|| {
            outside(
                "B",
                i,
                &(0..NU).map(|j| b[(i, j)]).collect::<Vec<_>>(),
                B_PATTERN[i],
            )
        })
        .or_else(|| {
            outside(
                "q",
                i,
                &(0..NX).map(|j| q[(i, j)]).collect::<Vec<_>>(),
                &of_q(i),
            )
        })
    };
    let soft = |j: usize| {
        let normal = stage.soft[j].normal;
        outside("soft_normal", j, normal.as_slice(), SOFT_PATTERN[j])
    };
    let outside = (0..NX).find_map(row).or_else(|| (0..n_soft).find_map(soft));
    if outside.is_some() {
        return outside;
    }
    if stage.proximal.min() < 0.0 {
        let [first, second] = stage.proximal.into();
        return Some(format!(
            "expected proximal of at least 0, got [{first}, {second}]"
        ));
    }
    // q has only the position block and a diagonal, so these conditions suffice.
    let convex =
        q.diagonal().min() >= 0.0 && q[(0, 1)].powi(2) <= q[(0, 0)] * q[(1, 1)] * (1.0 + 1e-12);
    (!convex).then(|| "expected positive semidefinite q, so that a minimum exists".to_owned())
}

fn wrong(message: String) -> PyErr {
    InvalidArgumentError::new_err(message)
}
