//! Mehrotra's predictor-corrector method on the stage-wise problem (Nocedal & Wright, *Numerical Optimization*, 2nd
//! ed., algorithm 16.4; Rao, Wright & Rawlings, JOTA 99, 1998).
//!
//! States are rolled out from the controls, so the dynamics hold at every iterate and stationarity is required of the
//! controls only. Its residual is computed with the adjoint states.

use super::active_set::ActiveSet;
use super::crossover::crossover;
use super::one_sided::{
    Iterate, OneSided, ROWS, Residual, RightHandSide, Rows, Scaling, Targets, larger, largest,
    signed_values,
};
use super::recursion::{Aug, Factor, Symmetric, backward, factorise, forward};
use super::stage::Stage;
use crate::NU;

/// Intermediate results of an iteration for one stage.
#[derive(Clone, Copy, Debug)]
struct StageWork {
    rows: OneSided,
    y: Rows,
    residual: Residual,
    scaling: Scaling,
    factor: Factor,
    /// `L⁻¹ q_v` of the current right-hand side.
    feedforward: [f64; NU],
    targets: Targets,
    rhs: RightHandSide,
    /// Newton direction of the control and of the rows.
    dv: [f64; NU],
    direction: Iterate,
}

/// Primal-dual point of a stage.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Point {
    pub v: [f64; NU],
    /// `s⁺`.
    pub s: Aug,
    pub rows: Iterate,
}

/// `s⁺ = Ā s + B̄ v + c` along the horizon.
#[inline(always)]
fn roll_out(initial: &Aug, stages: &[Stage], points: &mut [Point]) {
    let mut s = *initial;
    for (stage, point) in stages.iter().zip(points) {
        s = stage.successor(&s, &point.v);
        point.s = s;
    }
}

/// How a solve ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Outcome {
    /// The active-set method found the solution.
    SolvedByActiveSet,
    /// Residuals and complementarity are below the tolerance.
    Converged,
    /// The iteration limit was reached before convergence.
    IterationLimit,
    /// A factorisation failed or the iterate is no longer finite.
    Breakdown,
}

/// Residuals of the optimality conditions at a point: the largest entry of each.
#[derive(Clone, Copy, Debug)]
struct Optimality {
    /// Stationarity in the controls and in `ε`, relative to the largest term in the controls (at least 1).
    stationarity: f64,
    /// Violation of the rows.
    primal: f64,
    /// Duality measure: mean product of slack and multiplier.
    mu: f64,
}

/// The interior-point method and its memory.
#[derive(Clone, Debug)]
pub(super) struct InteriorPoint {
    work: Vec<StageWork>,
    /// Number of complementary pairs, at least one because every stage has hard rows.
    n_pairs: f64,
}

/// Initial barrier parameter. It is large so that the first steps from a distant start are not short.
const INITIAL_MU: f64 = 1e4;

/// Tolerance of the duality measure relative to the tolerance of the other residuals. It is smaller because the error
/// of a solution with a weakly active bound is as large as the square root of the duality measure.
const COMPLEMENTARITY_FACTOR: f64 = 1e-4;

/// Step length as a share of the largest that keeps slacks and multipliers positive.
const FRACTION_TO_BOUNDARY: f64 = 0.995;

/// Barrier parameter below which the active-set method is first tried.
const CROSSOVER_MU: f64 = 1e-3;

/// Factor by which the barrier parameter decreases between one trial of the active-set method and the next.
const CROSSOVER_DECREASE: f64 = 0.03;

/// Primal residual below which the active-set method is tried.
const CROSSOVER_PRIMAL: f64 = 1e-2;

impl InteriorPoint {
    pub fn new(horizon: usize) -> Self {
        let rows = [0.0; ROWS];
        let iterate = Iterate {
            slack: rows,
            lambda: rows,
            epsilon: rows,
            gamma: rows,
        };
        let work = StageWork {
            rows: OneSided::default(),
            y: rows,
            residual: Residual {
                primal: rows,
                epsilon: rows,
            },
            scaling: Scaling::default(),
            factor: Factor::default(),
            feedforward: [0.0; NU],
            targets: Targets {
                first: rows,
                second: rows,
            },
            rhs: RightHandSide {
                lambda: rows,
                epsilon: rows,
            },
            dv: [0.0; NU],
            direction: iterate,
        };
        Self {
            work: vec![work; horizon],
            n_pairs: 1.0,
        }
    }

    /// Iterates on `points` until the residuals are below `tolerance`, the active-set method converges, or `limit`
    /// iterations are spent. Returns the outcome and the number of iterations.
    #[inline(always)]
    pub fn run(
        &mut self,
        initial: &Aug,
        stages: &[Stage],
        points: &mut [Point],
        active_set: &mut ActiveSet,
        tolerance: f64,
        limit: u32,
    ) -> (Outcome, u32) {
        for (stage, work) in stages.iter().zip(&mut self.work) {
            work.rows = OneSided::of(&stage.rows);
        }
        self.n_pairs = self.work.iter().map(|work| work.rows.n_pairs()).sum();
        let mut next_crossover = CROSSOVER_MU;
        if !self.start(initial, stages, points) {
            return (Outcome::Breakdown, 0);
        }
        for iteration in 0..=limit {
            roll_out(initial, stages, points);
            let Optimality {
                stationarity,
                primal,
                mu,
            } = self.residuals(stages, points);
            let worst = stationarity.max(primal).max(mu / COMPLEMENTARITY_FACTOR);
            if !(stationarity + primal + mu).is_finite() {
                return (Outcome::Breakdown, iteration);
            }
            if worst <= tolerance {
                return (Outcome::Converged, iteration);
            }
            if mu < next_crossover && primal < CROSSOVER_PRIMAL {
                next_crossover = mu * CROSSOVER_DECREASE;
                crossover(stages, points, active_set);
                if active_set.solve(stages, tolerance) {
                    return (Outcome::SolvedByActiveSet, iteration);
                }
            }
            if iteration < limit {
                if !self.factorise(stages, points) {
                    return (Outcome::Breakdown, iteration);
                }
                self.step(stages, points, mu, 0.1 * COMPLEMENTARITY_FACTOR * tolerance);
            }
        }
        (Outcome::IterationLimit, limit)
    }

    /// Sets the initial iterate: the controls of the LQ regulator without inequalities, moved inside all hard bounds
    /// stage by stage, and each row on its own central path. False if the factorisation fails.
    #[inline(always)]
    fn start(&mut self, initial: &Aug, stages: &[Stage], points: &mut [Point]) -> bool {
        for point in points.iter_mut() {
            point.v = [0.0; NU];
            point.rows = Iterate::default();
        }
        roll_out(initial, stages, points);
        let mut p = Symmetric::default();
        let mut gradient = Aug::default();
        for ((stage, point), work) in stages.iter().zip(points.iter()).zip(&mut self.work).rev() {
            p.add(&stage.cost);
            gradient.add(&stage.cost_gradient(&point.s));
            let Some((factor, previous)) = factorise(&stage.dynamics, &stage.rate, &p) else {
                return false;
            };
            work.factor = factor;
            p = previous;
            (gradient, work.feedforward) =
                backward(&stage.dynamics, &work.factor, &gradient, &[0.0; NU]);
        }
        let mut s = *initial;
        let mut ds = Aug::default();
        for ((stage, point), work) in stages.iter().zip(points.iter_mut()).zip(&self.work) {
            let (v, _) = forward(&stage.dynamics, &work.factor, &work.feedforward, &ds);
            point.v = work.rows.interior_control(&v, &s.u);
            let free = point.s;
            s = stage.successor(&s, &point.v);
            point.s = s;
            for (d, (a, b)) in ds.x.iter_mut().zip(s.x.iter().zip(&free.x)) {
                *d = a - b;
            }
            for (d, (a, b)) in ds.u.iter_mut().zip(s.u.iter().zip(&free.u)) {
                *d = a - b;
            }
        }
        for ((stage, point), work) in stages.iter().zip(points.iter_mut()).zip(&self.work) {
            let y = signed_values(&point.v, &point.s, &stage.rows.normal);
            point.rows = work.rows.centred(&y, INITIAL_MU);
        }
        true
    }

    /// Computes row values and residuals; stationarity in the controls uses the adjoint states.
    #[inline(always)]
    fn residuals(&mut self, stages: &[Stage], points: &[Point]) -> Optimality {
        let mut adjoint = Aug::default();
        let mut scale = 1.0_f64;
        let mut stationarity = 0.0_f64;
        let (mut primal, mut epsilon, mut products) = ([0.0; ROWS], [0.0; ROWS], [0.0; ROWS]);
        for ((stage, point), work) in stages.iter().zip(points).zip(&mut self.work).rev() {
            let rows = &work.rows;
            work.y = signed_values(&point.v, &point.s, &rows.normal);
            rows.residual(&work.y, &point.rows, &mut work.residual);
            for k in 0..ROWS {
                primal[k] = larger(primal[k], work.residual.primal[k].abs());
                epsilon[k] = larger(epsilon[k], work.residual.epsilon[k].abs());
            }
            rows.add_products(&point.rows, 0.0, &point.rows, &mut products);

            let mut next = stage.cost_gradient(&point.s);
            next.add(&adjoint);
            let (own, rate) = rows.gradient(&point.rows.lambda);
            next.add(&own);
            adjoint = stage.dynamics.apply_transposed(&next);
            for i in 0..NU {
                let own = stage.rate[i] * point.v[i];
                let g = own + rate[i] + adjoint.u[i];
                scale = scale
                    .max(own.abs())
                    .max(rate[i].abs())
                    .max(adjoint.u[i].abs());
                // `f64::max` ignores NaN, but the residual must not.
                stationarity = if g.is_nan() {
                    g
                } else {
                    stationarity.max(g.abs())
                };
            }
        }
        Optimality {
            stationarity: larger(largest(&epsilon), stationarity) / scale,
            primal: largest(&primal),
            mu: products.iter().sum::<f64>() / self.n_pairs,
        }
    }

    /// Backward sweep of the Riccati recursion with the Hessian of the rows. False if a factorisation fails.
    #[inline(always)]
    fn factorise(&mut self, stages: &[Stage], points: &[Point]) -> bool {
        let mut p = Symmetric::default();
        for ((stage, point), work) in stages.iter().zip(points).zip(&mut self.work).rev() {
            work.rows.scale(&point.rows, &mut work.scaling);
            p.add(&stage.cost);
            let (curvature, mut rate) = work.rows.curvature(&work.scaling.weight);
            p.add(&curvature);
            for (rate, weight) in rate.iter_mut().zip(&stage.rate) {
                *rate += weight;
            }
            match factorise(&stage.dynamics, &rate, &p) {
                Some((factor, previous)) => {
                    work.factor = factor;
                    p = previous;
                }
                None => return false,
            }
        }
        true
    }

    /// Predictor, centring and corrector, then the step. `floor` is the smallest barrier parameter aimed at.
    #[inline(always)]
    fn step(&mut self, stages: &[Stage], points: &mut [Point], mu: f64, floor: f64) {
        self.newton(stages, points, |rows, _| Targets::affine(rows));
        let affine = self.max_step(points);
        let mut products = [0.0; ROWS];
        for (point, work) in points.iter().zip(&self.work) {
            work.rows
                .add_products(&point.rows, affine, &work.direction, &mut products);
        }
        let after = products.iter().sum::<f64>() / self.n_pairs;
        let ratio = (after / mu).clamp(0.0, 1.0);
        let target = (ratio * ratio * ratio * mu).max(floor);
        self.newton(stages, points, |rows, affine| {
            Targets::corrected(rows, affine, target)
        });
        let max_step = self.max_step(points);
        let step = if max_step < 1.0 {
            FRACTION_TO_BOUNDARY * max_step
        } else {
            1.0
        };
        for (point, work) in points.iter_mut().zip(&self.work) {
            for (v, dv) in point.v.iter_mut().zip(&work.dv) {
                *v = step.mul_add(*dv, *v);
            }
            point.rows.advance(step, &work.direction);
        }
    }

    /// Solves the Newton system. `targets` gives the right-hand sides of the complementarity conditions from the
    /// iterate and the previous direction.
    #[inline(always)]
    fn newton(
        &mut self,
        stages: &[Stage],
        points: &[Point],
        targets: impl Fn(&Iterate, &Iterate) -> Targets,
    ) {
        let mut p = Aug::default();
        for ((stage, point), work) in stages.iter().zip(points).zip(&mut self.work).rev() {
            work.targets = targets(&point.rows, &work.direction);
            work.scaling
                .right_hand_side(&point.rows, &work.residual, &work.targets, &mut work.rhs);
            let mut lambda = [0.0; ROWS];
            for (sum, (lambda, step)) in lambda
                .iter_mut()
                .zip(point.rows.lambda.iter().zip(&work.rhs.lambda))
            {
                *sum = lambda + step;
            }
            let mut next = stage.cost_gradient(&point.s);
            next.add(&p);
            let (own, mut g_v) = work.rows.gradient(&lambda);
            next.add(&own);
            for i in 0..NU {
                g_v[i] = stage.rate[i].mul_add(point.v[i], g_v[i]);
            }
            (p, work.feedforward) = backward(&stage.dynamics, &work.factor, &next, &g_v);
        }
        let mut ds = Aug::default();
        for ((stage, point), work) in stages.iter().zip(points).zip(&mut self.work) {
            (work.dv, ds) = forward(&stage.dynamics, &work.factor, &work.feedforward, &ds);
            let dy = signed_values(&work.dv, &ds, &stage.rows.normal);
            work.rows.recover(
                &work.scaling,
                &work.rhs,
                &point.rows,
                &work.residual,
                &work.targets,
                &dy,
                &mut work.direction,
            );
        }
    }

    /// Largest step length, at most 1, that keeps slacks and multipliers nonnegative.
    #[inline(always)]
    fn max_step(&self, points: &[Point]) -> f64 {
        let mut worst = [1.0; ROWS];
        for (point, work) in points.iter().zip(&self.work) {
            work.rows
                .max_decrease(&point.rows, &work.direction, &mut worst);
        }
        1.0 / largest(&worst)
    }
}
