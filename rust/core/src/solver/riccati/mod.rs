//! Structure-exploiting solver for [`OcpQp`] over stage-wise Riccati recursions, on fixed arrays.
//!
//! The solver first tries a dual active-set method from the guess or from the saturated LQ regulator. It changes the
//! working set by low-rank updates of one Riccati factorisation, so its work grows with the number of changes. If the
//! initial working set is far from the solution, which the number of contradicting rows shows, Mehrotra's
//! interior-point method iterates until slacks and multipliers identify the active rows, and the active-set method
//! solves the problem from there exactly (crossover).
//!
//! - [`recursion`]: the LQ problem augmented by the applied input, one stage at a time;
//! - [`stage`]: data and order of the rows of a stage;
//! - [`two_sided`], [`active_set`]: the active-set method and its form of the rows;
//! - [`exchange`], [`low_rank`]: the changes of the working set and the updates of the factorisation;
//! - [`one_sided`], [`interior_point`]: the interior-point method and its form of the rows;
//! - [`crossover`]: from the interior-point method to the active-set method;
//! - this file: conversion from and to [`OcpQp`].
//!
//! Time grows linearly with the horizon, nothing is allocated after construction, and the result depends on problem and
//! guess alone.

#![allow(clippy::needless_range_loop)] // index loops read like the formulas and are vectorised

mod active_set;
mod crossover;
mod exchange;
mod interior_point;
mod low_rank;
mod one_sided;
mod recursion;
mod stage;
mod two_sided;

use active_set::ActiveSet;
use interior_point::{InteriorPoint, Outcome, Point};
use recursion::Aug;
use stage::{INPUT, PAIRS, STATE, Stage, TRACK};
use two_sided::TwoSided;

use super::{QpSolver, Status};
use crate::qp::{self, MAX_SOFT, Multipliers, OcpQp, OcpSolution};
use crate::settings::SolverSettings;
use crate::simd::{Vectorised, vectorised};
use crate::vehicle::{P_X, P_Y};
use crate::{Input, NU, NX};

/// Row of a stage for each soft row of [`OcpQp`].
const SOFT_ROW: [usize; MAX_SOFT] = [STATE, STATE + 1, TRACK, STATE + 2, STATE + 3];

/// Solver that exploits the stage-wise structure of the problem.
#[derive(Debug)]
pub struct RiccatiSolver {
    tolerance: f64,
    limit: u32,
    stages: Vec<Stage>,
    points: Vec<Point>,
    active_set: ActiveSet,
    interior_point: InteriorPoint,
}

impl RiccatiSolver {
    /// A solver for problems with this horizon.
    pub fn new(horizon: usize, settings: &SolverSettings) -> Self {
        Self {
            tolerance: settings.tolerance,
            limit: settings.max_iterations,
            stages: vec![Stage::default(); horizon],
            points: vec![Point::default(); horizon],
            active_set: ActiveSet::new(horizon),
            interior_point: InteriorPoint::new(horizon),
        }
    }
}

impl QpSolver for RiccatiSolver {
    fn solve(&mut self, qp: &OcpQp, guess: &[Input], out: &mut OcpSolution) -> Status {
        let mut initial = Aug {
            u: qp.u_prev.into(),
            ..Aug::default()
        };
        initial.x[..NX].copy_from_slice(qp.x0.as_slice());
        let outcome = vectorised(Solve {
            solver: self,
            qp,
            initial,
            guess,
            iterations: &mut out.iterations,
        });
        let proposed = out.u.iter_mut().zip(&mut out.multipliers);
        if outcome == Outcome::SolvedByActiveSet {
            for (work, (u, multipliers)) in self.active_set.work.iter().zip(proposed) {
                *u = work.s.u.into();
                let upper = work.lambda.map(|value| value.max(0.0));
                let lower = work.lambda.map(|value| (-value).max(0.0));
                *multipliers = multipliers_of(&upper, &lower);
            }
        } else {
            for (point, (u, multipliers)) in self.points.iter().zip(proposed) {
                *u = point.s.u.into();
                let lambda = &point.rows.lambda;
                *multipliers = multipliers_of(lambda, &lambda[PAIRS..]);
            }
        }
        match outcome {
            Outcome::SolvedByActiveSet | Outcome::Converged => Status::Solved,
            Outcome::IterationLimit => Status::IterationLimit,
            Outcome::Breakdown => Status::NumericalError,
        }
    }

    fn name(&self) -> &'static str {
        "riccati"
    }
}

/// One solve, compiled for the available instruction sets.
struct Solve<'a> {
    solver: &'a mut RiccatiSolver,
    qp: &'a OcpQp,
    initial: Aug,
    guess: &'a [Input],
    iterations: &'a mut u32,
}

impl Vectorised for Solve<'_> {
    type Output = Outcome;

    #[inline(always)]
    fn compute(self) -> Outcome {
        let RiccatiSolver {
            tolerance,
            limit,
            stages,
            points,
            active_set,
            interior_point,
        } = self.solver;
        for (stage, source) in stages.iter_mut().zip(self.qp.stages()) {
            load(stage, source, self.qp);
        }
        active_set.reset(stages);
        let started = if self.guess.len() == stages.len() {
            active_set.start_warm(&self.initial, stages, self.guess);
            true
        } else {
            active_set.start_cold(&self.initial, stages)
        };
        if started && active_set.solve(stages, *tolerance) {
            *self.iterations = active_set.iterations;
            return Outcome::SolvedByActiveSet;
        }
        let (outcome, iterations) = interior_point.run(
            &self.initial,
            stages,
            points,
            active_set,
            *tolerance,
            *limit,
        );
        *self.iterations = iterations + active_set.iterations;
        outcome
    }
}

/// Copies one stage into the form of the recursion.
#[inline(always)]
fn load(stage: &mut Stage, source: &qp::Stage, qp: &OcpQp) {
    for i in 0..NX {
        for j in 0..NX {
            stage.dynamics.columns[j][i] = source.a[(i, j)];
            stage.dynamics.a_rows[i][j] = source.a[(i, j)];
        }
        for j in 0..NU {
            stage.dynamics.columns[NX + j][i] = source.b[(i, j)];
        }
        stage.offset[i] = source.c[i];
        stage.cost.x[i] = source.q[(i, i)];
        stage.gradient[i] = -source.q[(i, i)] * source.reference[i];
    }
    stage.cost.cross = source.q[(P_X, P_Y)];
    stage.gradient[P_X] -= stage.cost.cross * source.reference[P_Y];
    stage.gradient[P_Y] -= stage.cost.cross * source.reference[P_X];
    stage.cost.u = (qp.r + source.proximal).into();
    stage.input_gradient = (-source.proximal.component_mul(&source.planned)).into();
    stage.rate = qp.r_d.into();
    stage.rows = load_rows(source, qp);
}

/// Rows of a stage. A soft row whose normal is zero bounds nothing and stays absent.
#[inline(always)]
fn load_rows(source: &qp::Stage, qp: &OcpQp) -> TwoSided {
    let mut rows = TwoSided::default();
    for i in 0..NU {
        rows.hard(i, source.du_min[i], source.du_max[i]);
        rows.hard(INPUT + i, source.u_min[i], source.u_max[i]);
    }
    let soft = source.soft.iter().zip(&qp.penalty).zip(SOFT_ROW);
    for ((row, penalty), k) in soft.take(qp.n_soft()) {
        if row.normal.amax() > 0.0 {
            rows.soft(k, row.lower, row.upper, *penalty);
            if k == TRACK {
                rows.normal = [row.normal[P_X], row.normal[P_Y]];
            }
        }
    }
    rows
}

/// The multipliers of a stage in the order of [`OcpQp`].
fn multipliers_of(upper: &[f64], lower: &[f64]) -> Multipliers {
    Multipliers {
        du_upper: [upper[0], upper[1]].into(),
        du_lower: [lower[0], lower[1]].into(),
        u_upper: [upper[INPUT], upper[INPUT + 1]].into(),
        u_lower: [lower[INPUT], lower[INPUT + 1]].into(),
        soft_upper: SOFT_ROW.map(|k| upper[k]),
        soft_lower: SOFT_ROW.map(|k| lower[k]),
    }
}
