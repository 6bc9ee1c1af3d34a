//! Structure-exploiting interior point for [`OcpQp`]: Mehrotra's predictor-corrector over stage-wise Riccati
//! recursions, on fixed arrays.
//!
//! - [`recursion`]: the LQ problem augmented by the applied input, one stage at a time;
//! - [`rows`]: the inequalities of a stage, eliminated row by row;
//! - [`stage`]: both together, and the point of an iterate;
//! - [`interior_point`]: the iteration;
//! - this file: from [`OcpQp`] and back.
//!
//! Time grows linearly with the horizon, nothing is allocated after construction, and the result is a function of the
//! problem alone.

#![allow(clippy::needless_range_loop)] // loops over lanes read like the formulas, and vectorise

mod interior_point;
mod recursion;
mod rows;
mod stage;

use interior_point::{Attempt, InteriorPoint, Outcome};
use recursion::Aug;
use rows::{Bounds, INPUT, PAIRS, STATE, TRACK};
use stage::{Point, Stage};

use super::{QpSolver, Status};
use crate::qp::{self, MAX_SOFT, Multipliers, OcpQp, OcpSolution};
use crate::settings::SolverSettings;
use crate::simd::vectorised;
use crate::{NU, NX};

/// The row that each soft row of [`OcpQp`] becomes.
const SOFT_ROW: [usize; MAX_SOFT] = [STATE, STATE + 1, TRACK, STATE + 2, STATE + 3];

/// The structured solver.
#[derive(Debug)]
pub struct RiccatiSolver {
    tolerance: f64,
    limit: u32,
    stages: Vec<Stage>,
    points: Vec<Point>,
    method: InteriorPoint,
}

impl RiccatiSolver {
    /// Memory for problems of that horizon.
    pub fn new(horizon: usize, settings: &SolverSettings) -> Self {
        Self {
            tolerance: settings.tolerance,
            limit: settings.max_iterations,
            stages: vec![Stage::default(); horizon],
            points: vec![Point::default(); horizon],
            method: InteriorPoint::new(horizon),
        }
    }
}

impl QpSolver for RiccatiSolver {
    fn solve(&mut self, qp: &OcpQp, out: &mut OcpSolution) -> Status {
        for (stage, source) in self.stages.iter_mut().zip(qp.stages()) {
            load(stage, source, qp);
        }
        let mut initial = Aug {
            u: qp.u_prev.into(),
            ..Aug::default()
        };
        for (own, x) in initial.x.iter_mut().zip(qp.x0.iter()) {
            *own = *x;
        }
        let (outcome, iterations) = vectorised(Attempt {
            method: &mut self.method,
            initial: &initial,
            stages: &self.stages,
            points: &mut self.points,
            tolerance: self.tolerance,
            limit: self.limit,
        });
        out.iterations = iterations;
        let proposed = out.u.iter_mut().zip(&mut out.multipliers);
        for (point, (u, multipliers)) in self.points.iter().zip(proposed) {
            *u = point.s.u.into();
            *multipliers = multipliers_of(point);
        }
        match outcome {
            Outcome::Converged => Status::Solved,
            Outcome::IterationLimit => Status::IterationLimit,
            Outcome::Breakdown => Status::NumericalError,
        }
    }

    fn name(&self) -> &'static str {
        "riccati"
    }
}

/// Lays one stage out for the recursion.
fn load(stage: &mut Stage, source: &qp::Stage, qp: &OcpQp) {
    *stage = Stage::default();
    let pull = source.q * source.reference;
    for i in 0..NX {
        for j in 0..NX {
            stage.dynamics.columns[j][i] = source.a[(i, j)];
            stage.dynamics.a_rows[i][j] = source.a[(i, j)];
            stage.hessian.xx[j][i] = source.q[(i, j)];
        }
        for j in 0..NU {
            stage.dynamics.columns[NX + j][i] = source.b[(i, j)];
        }
        stage.offset[i] = source.c[i];
        stage.gradient.x[i] = -pull[i];
    }
    for i in 0..NU {
        stage.hessian.uu[i][i] = qp.r[i];
        stage.rate[i] = qp.r_d[i];
    }
    load_rows(&mut stage.bounds, source, qp);
}

/// A soft row without a normal bounds nothing and is left out.
fn load_rows(bounds: &mut Bounds, source: &qp::Stage, qp: &OcpQp) {
    for i in 0..NU {
        bounds.hard(i, source.du_min[i], source.du_max[i]);
        bounds.hard(INPUT + i, source.u_min[i], source.u_max[i]);
    }
    let soft = source.soft.iter().zip(&qp.penalty).zip(SOFT_ROW);
    for ((row, penalty), k) in soft.take(qp.n_soft()) {
        if row.normal.amax() > 0.0 {
            bounds.soft(k, row.lower, row.upper, *penalty);
            if k == TRACK {
                bounds.normal = [row.normal[0], row.normal[1]];
            }
        }
    }
}

/// The multipliers of a stage in the order of [`OcpQp`].
fn multipliers_of(point: &Point) -> Multipliers {
    let upper = &point.rows.lambda;
    let lower = &upper[PAIRS..];
    Multipliers {
        du_upper: [upper[0], upper[1]].into(),
        du_lower: [lower[0], lower[1]].into(),
        u_upper: [upper[INPUT], upper[INPUT + 1]].into(),
        u_lower: [lower[INPUT], lower[INPUT + 1]].into(),
        soft_upper: SOFT_ROW.map(|k| upper[k]),
        soft_lower: SOFT_ROW.map(|k| lower[k]),
    }
}
