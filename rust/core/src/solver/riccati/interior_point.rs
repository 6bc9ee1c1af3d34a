//! Mehrotra's predictor-corrector method on the stage-wise problem (Nocedal & Wright, *Numerical Optimization*, 2nd
//! ed., algorithm 16.4; Rao, Wright & Rawlings, JOTA 99, 1998).
//!
//! States are rolled out from the controls, so the dynamics hold at every iterate and stationarity is required of the
//! controls only. The residual of stationarity is computed with the adjoint states.

use super::active_set::ActiveSet;
use super::crossover::crossover;
use super::one_sided::{
    Iterate, OneSided, ROWS, Residual, RightHandSide, Scaling, Targets, larger, largest,
    signed_values,
};
use super::recursion::{Aug, Factor, Symmetric, backward, factorise, forward};
use super::stage::Stage;
use crate::NU;

/// Intermediate results of an iteration for one stage.
#[derive(Clone, Copy, Debug, Default)]
struct StageWork {
    rows: OneSided,
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

/// How far an iterate is from the solution, without stationarity in the controls.
#[derive(Clone, Copy, Debug)]
struct Distance {
    /// Largest violation of a row.
    primal: f64,
    /// Largest residual of stationarity in `ε`.
    epsilon: f64,
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
        Self {
            work: vec![StageWork::default(); horizon],
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
        if !self.start(initial, stages, points) {
            return (Outcome::Breakdown, 0);
        }
        let mut next_crossover = CROSSOVER_MU;
        let mut step = 0.0;
        for iteration in 0..=limit {
            let Distance {
                primal,
                epsilon,
                mu,
            } = self.advance(initial, stages, points, step);
            if !(primal + epsilon + mu).is_finite() {
                return (Outcome::Breakdown, iteration);
            }
            // Stationarity takes a sweep of its own, which only an iterate near the solution needs.
            if primal.max(mu / COMPLEMENTARITY_FACTOR) <= tolerance
                && self.stationarity(stages, points, epsilon) <= tolerance
            {
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
                step = self.direction(stages, points, mu, 0.1 * COMPLEMENTARITY_FACTOR * tolerance);
            }
        }
        (Outcome::IterationLimit, limit)
    }

    /// Sets the initial iterate: the controls of the LQ regulator without inequalities, moved inside all hard bounds
    /// stage by stage, and each row on its own central path. False if the factorisation fails.
    #[inline(always)]
    fn start(&mut self, initial: &Aug, stages: &[Stage], points: &mut [Point]) -> bool {
        let mut s = *initial;
        for ((stage, point), work) in stages.iter().zip(points.iter_mut()).zip(&mut self.work) {
            s = stage.successor(&s, &[0.0; NU]);
            // If the factorisation fails, this is the iterate that is returned. It must not be that of an earlier problem.
            *point = Point {
                s,
                ..Point::default()
            };
            work.rows = OneSided::of(&stage.rows);
            (work.dv, work.direction) = ([0.0; NU], Iterate::ZERO);
        }
        self.n_pairs = self.work.iter().map(|work| work.rows.n_pairs()).sum();
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
            ds = s.minus(&free);
        }
        for ((stage, point), work) in stages.iter().zip(points.iter_mut()).zip(&self.work) {
            let y = signed_values(&point.v, &point.s, &stage.rows.normal);
            point.rows = work.rows.centred(&y, INITIAL_MU);
        }
        true
    }

    /// Takes a step of that length along the direction, rolls out the states and computes the residuals of the rows.
    #[inline(always)]
    fn advance(
        &mut self,
        initial: &Aug,
        stages: &[Stage],
        points: &mut [Point],
        step: f64,
    ) -> Distance {
        let mut s = *initial;
        let (mut primal, mut epsilon, mut products) = ([0.0; ROWS], [0.0; ROWS], [0.0; ROWS]);
        for ((stage, point), work) in stages.iter().zip(points).zip(&mut self.work) {
            for (v, dv) in point.v.iter_mut().zip(&work.dv) {
                *v = step.mul_add(*dv, *v);
            }
            s = stage.successor(&s, &point.v);
            point.s = s;
            point.rows.advance(step, &work.direction);
            let y = signed_values(&point.v, &point.s, &work.rows.normal);
            work.rows.residual(&y, &point.rows, &mut work.residual);
            for k in 0..ROWS {
                primal[k] = larger(primal[k], work.residual.primal[k].abs());
                epsilon[k] = larger(epsilon[k], work.residual.epsilon[k].abs());
            }
            work.rows.add_products(&point.rows, &mut products);
        }
        Distance {
            primal: largest(&primal),
            epsilon: largest(&epsilon),
            mu: products.iter().sum::<f64>() / self.n_pairs,
        }
    }

    /// Largest residual of stationarity in the controls, by the adjoint states, and in `ε`, relative to the largest
    /// term in the controls (at least 1).
    #[inline(always)]
    fn stationarity(&self, stages: &[Stage], points: &[Point], epsilon: f64) -> f64 {
        let mut adjoint = Aug::default();
        let mut scale = 1.0_f64;
        let mut worst = epsilon;
        for ((stage, point), work) in stages.iter().zip(points).zip(&self.work).rev() {
            let mut next = stage.cost_gradient(&point.s);
            next.add(&adjoint);
            let (own, rate) = work.rows.gradient(&point.rows.lambda);
            next.add(&own);
            adjoint = stage.dynamics.apply_transposed(&next);
            for i in 0..NU {
                let own = stage.rate[i] * point.v[i];
                let g = own + rate[i] + adjoint.u[i];
                scale = scale
                    .max(own.abs())
                    .max(rate[i].abs())
                    .max(adjoint.u[i].abs());
                worst = worst.max(g.abs());
            }
        }
        worst / scale
    }

    /// Backward sweep of the Riccati recursion with the Hessian of the rows, and for the right-hand side of the
    /// predictor. False if a factorisation fails.
    #[inline(always)]
    fn factorise(&mut self, stages: &[Stage], points: &[Point]) -> bool {
        let mut p = Symmetric::default();
        let mut gradient = Aug::default();
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
            work.targets = Targets::affine(&point.rows);
            gradient = work.eliminate(stage, point, &gradient);
        }
        true
    }

    /// The direction of Mehrotra's method: predictor, centring and corrector. `mu` is the duality measure and `floor`
    /// the smallest barrier parameter aimed at. Returns the length of the step.
    #[inline(always)]
    fn direction(&mut self, stages: &[Stage], points: &[Point], mu: f64, floor: f64) -> f64 {
        let (affine, second) = self.forward(stages, points);
        // The predictor's equation is s Δλ + λ Δs = −s λ, so the products after its step need ΔsᵀΔλ only.
        let after = (1.0 - affine) * mu + affine * affine * second / self.n_pairs;
        let ratio = (after / mu).clamp(0.0, 1.0);
        let target = (ratio * ratio * ratio * mu).max(floor);
        let mut gradient = Aug::default();
        for ((stage, point), work) in stages.iter().zip(points).zip(&mut self.work).rev() {
            work.targets = Targets::corrected(&point.rows, &work.direction, target);
            gradient = work.eliminate(stage, point, &gradient);
        }
        let (longest, _) = self.forward(stages, points);
        if longest < 1.0 {
            FRACTION_TO_BOUNDARY * longest
        } else {
            1.0
        }
    }

    /// Forward sweep: the Newton direction. Returns the largest step length, at most 1, that keeps slacks and
    /// multipliers nonnegative, and the sum of the products `Δs Δλ + Δε Δγ`.
    #[inline(always)]
    fn forward(&mut self, stages: &[Stage], points: &[Point]) -> (f64, f64) {
        let mut ds = Aug::default();
        let (mut worst, mut products) = ([1.0; ROWS], [0.0; ROWS]);
        for ((stage, point), work) in stages.iter().zip(points).zip(&mut self.work) {
            (work.dv, ds) = forward(&stage.dynamics, &work.factor, &work.feedforward, &ds);
            let dy = signed_values(&work.dv, &ds, &work.rows.normal);
            work.rows.recover(
                &work.scaling,
                &work.rhs,
                &point.rows,
                &work.residual,
                &work.targets,
                &dy,
                &mut work.direction,
            );
            work.rows
                .max_decrease(&point.rows, &work.direction, &mut worst);
            work.rows.add_products(&work.direction, &mut products);
        }
        (1.0 / largest(&worst), products.iter().sum())
    }
}

impl StageWork {
    /// One stage of the backward sweep for the present targets: eliminates the steps of the rows, sets the feedforward
    /// term, and returns the gradient of the cost-to-go before the stage.
    #[inline(always)]
    fn eliminate(&mut self, stage: &Stage, point: &Point, gradient: &Aug) -> Aug {
        self.scaling
            .right_hand_side(&point.rows, &self.residual, &self.targets, &mut self.rhs);
        let mut lambda = [0.0; ROWS];
        for k in 0..ROWS {
            lambda[k] = point.rows.lambda[k] + self.rhs.lambda[k];
        }
        let mut next = stage.cost_gradient(&point.s);
        next.add(gradient);
        let (own, mut g_v) = self.rows.gradient(&lambda);
        next.add(&own);
        for i in 0..NU {
            g_v[i] = stage.rate[i].mul_add(point.v[i], g_v[i]);
        }
        let (before, feedforward) = backward(&stage.dynamics, &self.factor, &next, &g_v);
        self.feedforward = feedforward;
        before
    }
}
