//! Mehrotra's predictor-corrector on the stage-wise problem (Nocedal & Wright, *Numerical
//! Optimization*, 2nd ed., algorithm 16.4; Rao, Wright & Rawlings, JOTA 99, 1998).
//!
//! States are always rolled out from the controls, so the dynamics hold at every iterate and the
//! only stationarity left is that of the controls, taken through the adjoint.

use super::active_set::ActiveSet;
use super::crossover::hand_over;
use super::recursion::{Aug, Factor, Symmetric, backward, factorise, forward};
use super::rows::{
    Bounds, Iterate, Push, ROWS, Residual, Rows, Scaling, Targets, larger, largest, signed_values,
};
use super::stage::Stage;
use crate::NU;

/// What an iteration keeps of a stage between its passes.
#[derive(Clone, Copy, Debug)]
struct Pass {
    bounds: Bounds,
    y: Rows,
    residual: Residual,
    scaling: Scaling,
    factor: Factor,
    /// `L⁻¹ q_v` of the current right-hand side.
    lead: [f64; NU],
    targets: Targets,
    push: Push,
    dv: [f64; NU],
    step: Iterate,
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

/// How an attempt ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Outcome {
    /// The active set ended it.
    Ended,
    /// Residuals and complementarity are below the tolerance.
    Converged,
    /// The iteration limit came first.
    IterationLimit,
    /// The factorisation broke down or the iterate left the finite numbers.
    Breakdown,
}

/// Optimality of a point: the largest entry of each residual.
#[derive(Clone, Copy, Debug)]
struct Optimality {
    /// Stationarity of the controls relative to its largest term (at least 1), and of the slack prices.
    stationarity: f64,
    /// Violation of the rows.
    primal: f64,
    /// Mean product of slack and multiplier.
    mu: f64,
}

/// Memory and method of the interior point.
#[derive(Clone, Debug)]
pub(super) struct InteriorPoint {
    passes: Vec<Pass>,
    /// Products of slack and multiplier; every stage has hard rows.
    products: f64,
}

/// Complementarity of the start: large, so that a start far from the solution has room to move.
const START: f64 = 1e4;

/// Complementarity must be this much smaller than the other residuals: where a bound is only just
/// active, the solution is off by its square root.
const SHARPNESS: f64 = 1e-4;

/// Share of the way to the boundary that a step may go.
const FRACTION_TO_BOUNDARY: f64 = 0.995;

/// Complementarity at which the rows that press are told apart for the first time, and the factor to each next time.
const END: f64 = 1e-3;
const END_AGAIN: f64 = 0.03;

/// Violation of the rows at which it is worth while.
const END_PRIMAL: f64 = 1e-2;

impl InteriorPoint {
    pub fn new(horizon: usize) -> Self {
        let rows = [0.0; ROWS];
        let iterate = Iterate {
            slack: rows,
            lambda: rows,
            epsilon: rows,
            gamma: rows,
        };
        let pass = Pass {
            bounds: Bounds::default(),
            y: rows,
            residual: Residual {
                primal: rows,
                price: rows,
            },
            scaling: Scaling::default(),
            factor: Factor::default(),
            lead: [0.0; NU],
            targets: Targets {
                first: rows,
                second: rows,
            },
            push: Push {
                shift: rows,
                drive: rows,
            },
            dv: [0.0; NU],
            step: iterate,
        };
        Self {
            passes: vec![pass; horizon],
            products: 1.0,
        }
    }

    /// Improves `points` until `tolerance` or `limit`; returns the outcome and the iterations spent.
    #[inline(always)]
    pub fn run(
        &mut self,
        initial: &Aug,
        stages: &[Stage],
        points: &mut [Point],
        end: &mut ActiveSet,
        tolerance: f64,
        limit: u32,
    ) -> (Outcome, u32) {
        for (stage, pass) in stages.iter().zip(&mut self.passes) {
            pass.bounds = Bounds::of(&stage.band);
        }
        self.products = self.passes.iter().map(|pass| pass.bounds.products()).sum();
        let mut next_end = END;
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
            let worst = stationarity.max(primal).max(mu / SHARPNESS);
            if !(stationarity + primal + mu).is_finite() {
                return (Outcome::Breakdown, iteration);
            }
            if worst <= tolerance {
                return (Outcome::Converged, iteration);
            }
            if mu < next_end && primal < END_PRIMAL {
                next_end = mu * END_AGAIN;
                hand_over(stages, points, end);
                if end.finish(stages, tolerance) {
                    return (Outcome::Ended, iteration);
                }
            }
            if iteration < limit {
                if !self.factorise(stages, points) {
                    return (Outcome::Breakdown, iteration);
                }
                self.improve(stages, points, mu, 0.1 * SHARPNESS * tolerance);
            }
        }
        (Outcome::IterationLimit, limit)
    }

    /// A start inside all hard rows: the LQ regulator without rows, its controls saturated on the
    /// way, and each row placed on its own central path.
    #[inline(always)]
    fn start(&mut self, initial: &Aug, stages: &[Stage], points: &mut [Point]) -> bool {
        for point in points.iter_mut() {
            point.v = [0.0; NU];
            point.rows = Iterate::default();
        }
        roll_out(initial, stages, points);
        let mut p = Symmetric::default();
        let mut gradient = Aug::default();
        for ((stage, point), pass) in stages.iter().zip(points.iter()).zip(&mut self.passes).rev() {
            p.add(&stage.cost);
            gradient.add(&stage.cost_gradient(&point.s));
            let Some((factor, previous)) = factorise(&stage.dynamics, &stage.rate, &p) else {
                return false;
            };
            pass.factor = factor;
            p = previous;
            (gradient, pass.lead) = backward(&stage.dynamics, &pass.factor, &gradient, &[0.0; NU]);
        }
        let mut s = *initial;
        let mut ds = Aug::default();
        for ((stage, point), pass) in stages.iter().zip(points.iter_mut()).zip(&self.passes) {
            let (v, _) = forward(&stage.dynamics, &pass.factor, &pass.lead, &ds);
            point.v = pass.bounds.inside(&v, &s.u);
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
        for ((stage, point), pass) in stages.iter().zip(points.iter_mut()).zip(&self.passes) {
            let y = signed_values(&point.v, &point.s, &stage.band.normal);
            point.rows = pass.bounds.centred(&y, START);
        }
        true
    }

    /// Row values, residuals, and stationarity of the controls by the adjoint.
    #[inline(always)]
    fn residuals(&mut self, stages: &[Stage], points: &[Point]) -> Optimality {
        let mut adjoint = Aug::default();
        let mut scale = 1.0_f64;
        let mut stationarity = 0.0_f64;
        let (mut primal, mut price, mut products) = ([0.0; ROWS], [0.0; ROWS], [0.0; ROWS]);
        for ((stage, point), pass) in stages.iter().zip(points).zip(&mut self.passes).rev() {
            let bounds = &pass.bounds;
            pass.y = signed_values(&point.v, &point.s, &bounds.normal);
            bounds.residual(&pass.y, &point.rows, &mut pass.residual);
            for k in 0..ROWS {
                primal[k] = larger(primal[k], pass.residual.primal[k].abs());
                price[k] = larger(price[k], pass.residual.price[k].abs());
            }
            bounds.add_products(&point.rows, 0.0, &point.rows, &mut products);

            let mut next = stage.cost_gradient(&point.s);
            next.add(&adjoint);
            let (own, rate) = bounds.gradient(&point.rows.lambda);
            next.add(&own);
            adjoint = stage.dynamics.apply_transposed(&next);
            for i in 0..NU {
                let own = stage.rate[i] * point.v[i];
                let g = own + rate[i] + adjoint.u[i];
                scale = scale
                    .max(own.abs())
                    .max(rate[i].abs())
                    .max(adjoint.u[i].abs());
                // `max` forgets NaN, a sum does not.
                stationarity = if g.is_nan() {
                    g
                } else {
                    stationarity.max(g.abs())
                };
            }
        }
        Optimality {
            stationarity: larger(largest(&price), stationarity) / scale,
            primal: largest(&primal),
            mu: products.iter().sum::<f64>() / self.products,
        }
    }

    /// The Riccati recursion with the rows' curvature.
    #[inline(always)]
    fn factorise(&mut self, stages: &[Stage], points: &[Point]) -> bool {
        let mut p = Symmetric::default();
        for ((stage, point), pass) in stages.iter().zip(points).zip(&mut self.passes).rev() {
            pass.bounds.scale(&point.rows, &mut pass.scaling);
            p.add(&stage.cost);
            let (curvature, mut rate) = pass.bounds.curvature(&pass.scaling.weight);
            p.add(&curvature);
            for (rate, weight) in rate.iter_mut().zip(&stage.rate) {
                *rate += weight;
            }
            match factorise(&stage.dynamics, &rate, &p) {
                Some((factor, previous)) => {
                    pass.factor = factor;
                    p = previous;
                }
                None => return false,
            }
        }
        true
    }

    /// Predictor, centring, corrector and the step.
    #[inline(always)]
    fn improve(&mut self, stages: &[Stage], points: &mut [Point], mu: f64, floor: f64) {
        self.newton(stages, points, |rows, _| Targets::affine(rows));
        let affine = self.longest(points);
        let mut products = [0.0; ROWS];
        for (point, pass) in points.iter().zip(&self.passes) {
            pass.bounds
                .add_products(&point.rows, affine, &pass.step, &mut products);
        }
        let after = products.iter().sum::<f64>() / self.products;
        let ratio = (after / mu).clamp(0.0, 1.0);
        let target = (ratio * ratio * ratio * mu).max(floor);
        self.newton(stages, points, |rows, step| {
            Targets::corrected(rows, step, target)
        });
        let longest = self.longest(points);
        let step = if longest < 1.0 {
            FRACTION_TO_BOUNDARY * longest
        } else {
            1.0
        };
        for (point, pass) in points.iter_mut().zip(&self.passes) {
            for (v, dv) in point.v.iter_mut().zip(&pass.dv) {
                *v = step.mul_add(*dv, *v);
            }
            point.rows.advance(step, &pass.step);
        }
    }

    /// Solves the Newton system for the targets of complementarity that `aim` names from the
    /// iterate and the last step.
    #[inline(always)]
    fn newton(
        &mut self,
        stages: &[Stage],
        points: &[Point],
        aim: impl Fn(&Iterate, &Iterate) -> Targets,
    ) {
        let mut p = Aug::default();
        for ((stage, point), pass) in stages.iter().zip(points).zip(&mut self.passes).rev() {
            pass.targets = aim(&point.rows, &pass.step);
            pass.scaling
                .push(&point.rows, &pass.residual, &pass.targets, &mut pass.push);
            let mut force = [0.0; ROWS];
            for (f, (lambda, shift)) in force
                .iter_mut()
                .zip(point.rows.lambda.iter().zip(&pass.push.shift))
            {
                *f = lambda + shift;
            }
            let mut next = stage.cost_gradient(&point.s);
            next.add(&p);
            let (own, mut g_v) = pass.bounds.gradient(&force);
            next.add(&own);
            for i in 0..NU {
                g_v[i] = stage.rate[i].mul_add(point.v[i], g_v[i]);
            }
            (p, pass.lead) = backward(&stage.dynamics, &pass.factor, &next, &g_v);
        }
        let mut ds = Aug::default();
        for ((stage, point), pass) in stages.iter().zip(points).zip(&mut self.passes) {
            (pass.dv, ds) = forward(&stage.dynamics, &pass.factor, &pass.lead, &ds);
            let dy = signed_values(&pass.dv, &ds, &stage.band.normal);
            pass.bounds.recover(
                &pass.scaling,
                &pass.push,
                &point.rows,
                &pass.residual,
                &pass.targets,
                &dy,
                &mut pass.step,
            );
        }
    }

    /// Longest step that keeps slacks and multipliers positive.
    #[inline(always)]
    fn longest(&self, points: &[Point]) -> f64 {
        let mut worst = [1.0; ROWS];
        for (point, pass) in points.iter().zip(&self.passes) {
            pass.bounds
                .raise_decrease(&point.rows, &pass.step, &mut worst);
        }
        1.0 / largest(&worst)
    }
}
