//! Structure-exploiting solver for [`OcpQp`] over stage-wise Riccati recursions, on fixed arrays.
//!
//! An active set first, from the guess or from the saturated LQ regulator: a few recursions when it knows the rows
//! that press. Where it does not settle, Mehrotra's interior point goes on until the rows that press stand out, and
//! the active set ends it, exactly.
//!
//! - [`recursion`]: the LQ problem augmented by the applied input, one stage at a time;
//! - [`stage`]: its data and the rows bounded in it;
//! - [`band`], [`active_set`]: the rows as two-sided ones, and the method that guesses which of them press;
//! - [`rows`], [`interior_point`]: the rows as one-sided ones, eliminated row by row, and the method;
//! - [`crossover`]: from the latter to the former;
//! - this file: from [`OcpQp`] and back.
//!
//! Time grows linearly with the horizon, nothing is allocated after construction, and the result is a function of
//! problem and guess alone.

#![allow(clippy::needless_range_loop)] // loops over lanes read like the formulas, and vectorise

mod active_set;
mod band;
mod crossover;
mod interior_point;
mod recursion;
mod rows;
mod stage;

use active_set::ActiveSet;
use band::Band;
use interior_point::{InteriorPoint, Outcome, Point};
use recursion::Aug;
use stage::{INPUT, PAIRS, STATE, Stage, TRACK};

use super::{QpSolver, Status};
use crate::qp::{self, MAX_SOFT, Multipliers, OcpQp, OcpSolution};
use crate::settings::SolverSettings;
use crate::simd::{Vectorised, vectorised};
use crate::vehicle::{P_X, P_Y};
use crate::{Input, NU, NX};

/// The row that each soft row of [`OcpQp`] becomes.
const SOFT_ROW: [usize; MAX_SOFT] = [STATE, STATE + 1, TRACK, STATE + 2, STATE + 3];

/// The structured solver.
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
    /// Memory for problems of that horizon.
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
        let outcome = vectorised(Attempt {
            solver: self,
            qp,
            initial,
            guess,
            iterations: &mut out.iterations,
        });
        let proposed = out.u.iter_mut().zip(&mut out.multipliers);
        if outcome == Outcome::Ended {
            for (pass, (u, multipliers)) in self.active_set.passes.iter().zip(proposed) {
                *u = pass.s.u.into();
                let upper = pass.lambda.map(|value| value.max(0.0));
                let lower = pass.lambda.map(|value| (-value).max(0.0));
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
            Outcome::Ended | Outcome::Converged => Status::Solved,
            Outcome::IterationLimit => Status::IterationLimit,
            Outcome::Breakdown => Status::NumericalError,
        }
    }

    fn name(&self) -> &'static str {
        "riccati"
    }
}

/// One attempt at a problem.
struct Attempt<'a> {
    solver: &'a mut RiccatiSolver,
    qp: &'a OcpQp,
    initial: Aug,
    guess: &'a [Input],
    iterations: &'a mut u32,
}

impl Vectorised for Attempt<'_> {
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
        active_set.scale(stages);
        let started = if self.guess.len() == stages.len() {
            active_set.start_warm(&self.initial, stages, self.guess);
            true
        } else {
            active_set.start_cold(&self.initial, stages)
        };
        if started && active_set.finish(stages, *tolerance) {
            *self.iterations = active_set.iterations;
            return Outcome::Ended;
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

/// Lays one stage out for the recursion.
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
    stage.cost.u = qp.r.into();
    stage.rate = qp.r_d.into();
    stage.band = load_rows(source, qp);
}

/// A soft row without a normal bounds nothing and is left out.
#[inline(always)]
fn load_rows(source: &qp::Stage, qp: &OcpQp) -> Band {
    let mut rows = Band::default();
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
