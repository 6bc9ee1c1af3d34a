//! Primal-dual active set: semismooth Newton steps on the augmented Lagrangian of the rows (Hintermüller, Ito & Kunisch,
//! SIAM J. Optim. 13, 2002), each one Riccati recursion.
//!
//! Each step takes the rows that press now for equations and solves the LQ problem that is left. The rows that press
//! at its solution are the next guess; once they no longer change, only their multipliers are refined, at the price
//! of a right-hand side. Fast from a good guess, and exact where it ends, but it may cycle: the interior point comes
//! next.

use super::band::{Band, Pairs, Pressing, Response};
use super::recursion::{Aug, Factor, Symmetric, backward, factorise, forward};
use super::stage::{INPUT, PAIRS, STATE, Stage, row_curvature, row_gradient, row_values};
use crate::{Input, NU};

/// Stiffness of a pressing row, as a multiple of the largest weight of the cost.
const STIFFNESS: f64 = 1e6;

/// A guessed input or state this near to a bound presses against it.
const NEAR: f64 = 1e-3;

/// Right-hand sides that may be spent on the multipliers.
const REFINEMENTS: u32 = 15;

/// Steps that may fail to lower the number of rows that change.
const SETBACKS: u32 = 1;

/// Rows that may change at once, beside one for every other stage. Measured: of the starts that settle, nine in ten
/// change no more than five; where more change than this, hardly one does.
const MOST: usize = 6;

/// What the method keeps of a stage.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pass {
    pub v: [f64; NU],
    /// `s⁺`.
    pub s: Aug,
    /// Multipliers, positive at upper bounds.
    pub lambda: Pairs,
    response: Response,
    /// Derivatives that the factor was computed with.
    weight: Pairs,
    factor: Factor,
    /// Curvature of the cost-to-go after `s⁺`.
    after: Symmetric,
    /// `L⁻¹ q_v` of the current right-hand side.
    lead: [f64; NU],
}

/// Memory and method.
#[derive(Clone, Debug)]
pub(super) struct ActiveSet {
    pub passes: Vec<Pass>,
    /// Iterations so far, over all attempts at a problem.
    pub iterations: u32,
    rho: f64,
}

/// What a step did to the rows.
struct Change {
    /// Rows that began or ceased to press.
    rows: usize,
    /// Largest violation left by the multipliers being what they are.
    gap: f64,
}

impl ActiveSet {
    pub fn new(horizon: usize) -> Self {
        Self {
            passes: vec![Pass::default(); horizon],
            iterations: 0,
            rho: 1.0,
        }
    }

    /// Scales the method to a problem.
    #[inline(always)]
    pub fn scale(&mut self, stages: &[Stage]) {
        self.iterations = 0;
        self.rho = STIFFNESS
            * stages
                .iter()
                .flat_map(|s| s.cost.x.iter().chain(&s.cost.u).chain(&s.rate))
                .fold(f64::MIN_POSITIVE, |a, b| a.max(*b));
    }

    /// Goes on from the start that one of the functions below chose; true if it settled.
    ///
    /// It is given up once too many steps did not lower the number of rows that change, and where too many change at
    /// once: it cycles then.
    #[inline(always)]
    pub fn finish(&mut self, stages: &[Stage], tolerance: f64) -> bool {
        let (mut fewest, mut setbacks, mut refinements) = (usize::MAX, 0, 0);
        let most = MOST + stages.len() / 2;
        while setbacks <= SETBACKS && refinements <= REFINEMENTS {
            self.iterations += 1;
            if !self.backward(stages) {
                return false;
            }
            let change = self.forward(stages);
            if !change.gap.is_finite() || change.rows > most {
                return false;
            }
            if change.rows > 0 {
                if change.rows < fewest {
                    fewest = change.rows;
                } else {
                    setbacks += 1;
                }
                continue;
            }
            if change.gap <= tolerance {
                for pass in &mut self.passes {
                    pass.lambda = pass.response.force;
                }
                return true;
            }
            refinements += 1;
            for (stage, pass) in stages.iter().zip(&mut self.passes) {
                pass.lambda = pass.response.force;
                let y = row_values(&pass.v, &pass.s, &stage.band.normal);
                pass.response = stage.band.response(&y, &pass.lambda, self.rho);
            }
        }
        false
    }

    /// Starts from the LQ regulator without rows, saturated on the way.
    #[inline(always)]
    pub fn start_cold(&mut self, initial: &Aug, stages: &[Stage]) -> bool {
        let mut s = *initial;
        for (stage, pass) in stages.iter().zip(&mut self.passes) {
            s = stage.successor(&s, &[0.0; NU]);
            (pass.v, pass.s) = ([0.0; NU], s);
            pass.response = Response::default();
            pass.weight = [f64::NAN; PAIRS];
        }
        if !self.backward(stages) {
            return false;
        }
        let mut s = *initial;
        let mut ds = Aug::default();
        for (stage, pass) in stages.iter().zip(&mut self.passes) {
            let (v, _) = forward(&stage.dynamics, &pass.factor, &pass.lead, &ds);
            let free = pass.s;
            s = pass.place(stage, &s, v, 0.0, self.rho);
            ds = s.minus(&free);
        }
        true
    }

    /// Starts from guessed inputs, led to the bounds they are near to.
    #[inline(always)]
    pub fn start_warm(&mut self, initial: &Aug, stages: &[Stage], guess: &[Input]) {
        let mut s = *initial;
        for ((stage, pass), u) in stages.iter().zip(&mut self.passes).zip(guess) {
            pass.weight = [f64::NAN; PAIRS];
            let v = [u[0] - s.u[0], u[1] - s.u[1]];
            s = pass.place(stage, &s, v, NEAR, self.rho);
        }
    }

    /// Starts stage `t` from controls, states, multipliers and a guess of the pressing rows.
    #[inline(always)]
    pub fn start_stage(
        &mut self,
        t: usize,
        band: &Band,
        (v, s): ([f64; NU], Aug),
        lambda: Pairs,
        pressing: &Pressing,
    ) {
        let pass = &mut self.passes[t];
        (pass.v, pass.s, pass.lambda) = (v, s, lambda);
        pass.weight = [f64::NAN; PAIRS];
        let y = row_values(&v, &s, &band.normal);
        pass.response = band.taken(&y, &lambda, pressing, self.rho);
    }

    /// The recursion, from the last stage whose rows changed, and a right-hand side. False where it broke down.
    #[inline(always)]
    fn backward(&mut self, stages: &[Stage]) -> bool {
        let mut gradient = Aug::default();
        let mut curvature = Symmetric::default();
        let mut stale = false;
        for (stage, pass) in stages.iter().zip(&mut self.passes).rev() {
            let (band, response) = (&stage.band, &pass.response);
            // NaN, the mark of a stage without a factor, differs from everything.
            if stale || pass.weight != response.weight {
                if stale || pass.weight[0].is_nan() {
                    pass.after = curvature;
                }
                stale = true;
                let mut next = pass.after;
                next.add(&stage.cost);
                next.add(&row_curvature(&response.weight, &band.normal));
                let rate = [
                    stage.rate[0] + response.weight[0],
                    stage.rate[1] + response.weight[1],
                ];
                let Some((factor, before)) = factorise(&stage.dynamics, &rate, &next) else {
                    return false;
                };
                (pass.factor, curvature) = (factor, before);
                pass.weight = response.weight;
            }
            let mut next = stage.cost_gradient(&pass.s);
            next.add(&row_gradient(&response.force, &band.normal));
            next.add(&gradient);
            let g_v = [
                stage.rate[0].mul_add(pass.v[0], response.force[0]),
                stage.rate[1].mul_add(pass.v[1], response.force[1]),
            ];
            (gradient, pass.lead) = backward(&stage.dynamics, &pass.factor, &next, &g_v);
        }
        true
    }

    /// The full step.
    #[inline(always)]
    fn forward(&mut self, stages: &[Stage]) -> Change {
        let mut ds = Aug::default();
        let mut changed = [0_usize; PAIRS];
        let mut gap = [0.0_f64; PAIRS];
        let mut trace = 0.0;
        for (stage, pass) in stages.iter().zip(&mut self.passes) {
            let (dv, next) = forward(&stage.dynamics, &pass.factor, &pass.lead, &ds);
            ds = next;
            pass.s.add(&ds);
            for i in 0..NU {
                pass.v[i] += dv[i];
                trace += dv[i];
            }
            let y = row_values(&pass.v, &pass.s, &stage.band.normal);
            pass.response = stage.band.response(&y, &pass.lambda, self.rho);
            for k in 0..PAIRS {
                changed[k] += usize::from(pass.response.weight[k] != pass.weight[k]);
                let difference = (pass.response.force[k] - pass.lambda[k]).abs();
                gap[k] = if difference > gap[k] {
                    difference
                } else {
                    gap[k]
                };
            }
        }
        let gap = gap.iter().fold(0.0, |a: f64, b| a.max(*b)) / self.rho;
        Change {
            rows: changed.iter().sum(),
            gap: if trace.is_finite() { gap } else { f64::NAN },
        }
    }
}

impl Pass {
    /// Applies `v` as far as the bounds let it, exactly on those nearer than `near`, and takes the rows it touches
    /// for pressing.
    #[inline(always)]
    fn place(&mut self, stage: &Stage, s: &Aug, v: [f64; NU], near: f64, rho: f64) -> Aug {
        let band = &stage.band;
        let mut pressing = Pressing::default();
        let snap = |k: usize, value: f64| {
            let (value, side) = if value >= band.upper[k] - near {
                (band.upper[k], 1.0)
            } else if value <= band.lower[k] + near {
                (band.lower[k], -1.0)
            } else {
                (value, 0.0)
            };
            (value, side)
        };
        for i in 0..NU {
            let (input, side) = snap(INPUT + i, s.u[i] + v[i]);
            let wanted = input - s.u[i];
            (self.v[i], pressing.side[i]) = snap(i, wanted);
            if self.v[i] == wanted {
                pressing.side[INPUT + i] = side; // otherwise the rate came first
            }
        }
        self.s = stage.successor(s, &self.v);
        let y = row_values(&self.v, &self.s, &band.normal);
        for k in STATE..PAIRS {
            let (above, below) = (y[k] - band.upper[k], band.lower[k] - y[k]);
            if above > -near || below > -near {
                pressing.side[k] = if above > below { 1.0 } else { -1.0 };
                pressing.yielding[k] = above.max(below) > near;
            }
        }
        self.lambda = [0.0; PAIRS];
        self.response = band.taken(&y, &self.lambda, &pressing, rho);
        self.s
    }
}
