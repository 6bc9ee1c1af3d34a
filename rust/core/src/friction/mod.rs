//! The posterior of the friction coefficient, given the window of eq. (6).
//!
//! Each of [`friction_hypotheses`] about the friction coefficient `mu` has a model, whose innovations over the window (module
//! `innovations`) give a likelihood:
//!
//! ```text
//! q(mu) = (sum nu)ᵀ (sum S)⁻¹ (sum nu)
//! J(mu) = sum ||e||² - q(mu)
//! p(mu) ∝ p_0(mu) exp(-J(mu) / (2 tau max(1, min J / n))) (1 + q(mu))⁻²,    n = number of errors
//! ```
//!
//! The sums are over the window, `nu` are the innovations, `S` their covariances, and `e` the whitened innovations. `p_0` is
//! uniform over [`RANGE`], and the logarithm of the likelihood is interpolated in `ln mu`.
//!
//! The sum of the innovations has a Cauchy distribution of three dimensions: what a model of the vehicle lacks (a bank, a load,
//! other tyres) is alike in all transitions of a window, and of unknown size. A normal distribution would count it as
//! information about the friction, the more of it the longer the window. A window whose single errors no hypothesis explains,
//! `min J > n`, widens the posterior (a power posterior; Grünwald and van Ommen, *Inconsistency of Bayesian Inference for
//! Misspecified Linear Models*, Bayesian Analysis 12(4), 2017). Nothing but the window is remembered, so without excitation
//! the posterior returns to the prior within the length of the window.

mod hypothesis;
mod innovations;

use egp_parameters::{
    FRICTION_HYPOTHESES as HYPOTHESES, FRICTION_INFORMED as INFORMED, FRICTION_RANGE as RANGE,
    LEAST_LOG_LIKELIHOOD, friction_hypotheses, interpolate_hypotheses,
};
use hypothesis::Hypothesis;
use innovations::{Innovations, Square};
use nalgebra::{Cholesky, Const};

use crate::settings::WeightSettings;
use crate::vehicle::Batch;
use crate::{GpInput, GpOutput, Library, NY, NZ};

/// Magnitude of the largest logarithm from which the sum of densities may lose digits, become zero or overflow.
const EXTREME: f64 = 600.0;
/// Temperature of the likelihood. It is below 1 because the members' errors over all their data are larger than those of most
/// windows. `tests/bench/calibration.py` tells how often the 90 % interval contains the true value.
const TEMPERATURE: f64 = 0.88;
/// Largest misfit that is stated.
const MOST_MISFIT: f64 = 1e9;
/// Number of points at which the density is evaluated.
const POINTS: usize = 121;
/// Probabilities of the interval's ends.
const INTERVAL: (f64, f64) = (0.05, 0.95);

/// Posterior of the friction coefficient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrictionEstimate {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub std: f64,
    /// 5 % quantile.
    pub lower: f64,
    /// 95 % quantile.
    pub upper: f64,
    /// Kullback-Leibler divergence from the prior to the posterior, in nats: the information in the window.
    pub information: f64,
    /// Logarithm of the likelihood of each of [`friction_hypotheses`], relative to the largest.
    pub log_likelihood: [f64; HYPOTHESES],
    /// Test of the likeliest friction for bias, `(Σ nu)ᵀ (Σ S)⁻¹ (Σ nu) / 3` with the innovations `nu` of the window and their
    /// covariances `S` (module `innovations`), at most 1e9; 0 without transitions. For a model without systematic error it is
    /// distributed as a third of a chi-squared variable of three degrees of freedom, with mean 1 and median 0.79. It is larger
    /// if no friction explains the window, as with the library of another vehicle.
    pub misfit: f64,
}

impl FrictionEstimate {
    /// Whether the window has information about the friction: at least [`egp_parameters::FRICTION_INFORMED`].
    pub fn informed(&self) -> bool {
        self.information >= INFORMED
    }
}

impl Default for FrictionEstimate {
    /// The prior.
    fn default() -> Self {
        let (low, high) = RANGE;
        let width = high - low;
        Self {
            mean: f64::midpoint(low, high),
            std: width / 12.0_f64.sqrt(),
            lower: low + INTERVAL.0 * width,
            upper: low + INTERVAL.1 * width,
            information: 0.0,
            log_likelihood: [0.0; HYPOTHESES],
            misfit: 0.0,
        }
    }
}

/// Estimator of the friction for one library, with its memory.
#[derive(Debug, Clone)]
pub struct FrictionEstimator {
    innovations: Innovations,
    /// Largest number of transitions of a window.
    window: usize,
    hypotheses: Vec<Hypothesis>,
    /// Their vehicles.
    vehicles: Batch,
    /// The vehicles of the members.
    of_members: Batch,
    /// Position of each point of the density, counted in hypotheses.
    positions: Vec<f64>,
    /// What the Gaussian process of each member with a vehicle adds: its prediction less the change that its vehicle gives, which
    /// is written here first. The entries of members without a vehicle are not read.
    learned: Vec<GpOutput>,
    /// Change by the vehicle of each hypothesis and its Jacobian by `[v_x, v_y, omega]`; zero where there is none.
    changes: [(GpOutput, Square); HYPOTHESES],
    /// Deviation of the state that each hypothesis estimates from the measured one.
    deviations: [GpOutput; HYPOTHESES],
    /// Sum of the innovations, for each hypothesis.
    sums: [GpOutput; HYPOTHESES],
    /// Sum of the squares of the whitened innovations, for each hypothesis.
    squares: [f64; HYPOTHESES],
    density: Vec<f64>,
}

impl FrictionEstimator {
    /// An estimator for the members of the library. Errors are always whitened, also with `whiten = false`, and always by the
    /// largest expected noise. With a smaller noise the small model errors of the hypotheses would count as information.
    pub fn new(library: &Library, settings: &WeightSettings) -> Self {
        let (low, high) = RANGE;
        let gap = (high / low).ln() / (HYPOTHESES - 1) as f64;
        let members = library.members();
        let hypotheses: Vec<_> = friction_hypotheses()
            .iter()
            .map(|mu| Hypothesis::new(*mu, members))
            .collect();
        let vehicles = hypotheses.iter().map(Hypothesis::vehicle);
        let of_members = members.iter().map(|member| member.vehicle().copied());
        let positions = (0..POINTS).map(|i| (point(i) / low).ln() / gap).collect();
        Self {
            innovations: Innovations::new(library, settings),
            window: settings.window(library),
            vehicles: Batch::new(vehicles, library.dt()),
            of_members: Batch::new(of_members, library.dt()),
            hypotheses,
            positions,
            learned: vec![GpOutput::zeros(); members.len()],
            changes: [(GpOutput::zeros(), Square::zeros()); HYPOTHESES],
            deviations: [GpOutput::zeros(); HYPOTHESES],
            sums: [GpOutput::zeros(); HYPOTHESES],
            squares: [0.0; HYPOTHESES],
            density: vec![0.0; POINTS],
        }
    }

    /// The posterior given consecutive transitions, newest first.
    ///
    /// * `z`: inputs of the transitions
    /// * `predictions`: rows `[N * 3]`, the members' predictions for them
    /// * `measured`: the measured changes
    ///
    /// Without transitions this is the prior. Transitions beyond the window are ignored.
    pub fn estimate(
        &mut self,
        z: &[[f64; NZ]],
        predictions: &[f64],
        measured: &[[f64; NY]],
    ) -> FrictionEstimate {
        let rows = predictions.chunks_exact(self.learned.len() * NY);
        let transitions = self.window.min(rows.len()).min(z.len()).min(measured.len());
        if transitions == 0 {
            return FrictionEstimate::default();
        }
        self.squares.fill(0.0);
        self.deviations.fill(GpOutput::zeros());
        self.sums.fill(GpOutput::zeros());
        let mut covariance = Square::zeros();
        self.innovations.restart();
        let window = z.iter().zip(rows).zip(measured).take(transitions);
        for ((z, row), y) in window.rev() {
            let mut z = GpInput::from(*z);
            let f = row.as_chunks().0;
            self.of_members.changes(&z, &mut self.learned);
            for (learned, f) in self.learned.iter_mut().zip(f) {
                *learned = GpOutput::from(*f) - *learned;
            }
            let common = self.likely_deviation();
            let mut state = z.fixed_rows_mut::<NY>(0);
            state += common;
            let mut tangents = self.vehicles.tangents(&z);
            let mut mean = Square::zeros();
            for (i, by_vehicle) in self.changes.iter_mut().enumerate() {
                if let Some((change, jacobian)) = tangents.change_jacobian(i) {
                    *by_vehicle = (change, jacobian.fixed_columns::<NY>(0).into_owned());
                    mean += by_vehicle.1;
                }
            }
            let Some(gain) = self.innovations.next(&(mean / HYPOTHESES as f64)) else {
                return FrictionEstimate::default();
            };
            covariance += gain.covariance;
            let hypotheses = self.hypotheses.iter().zip(&self.changes);
            let sums = (self.squares.iter_mut())
                .zip(&mut self.deviations)
                .zip(&mut self.sums);
            for ((hypothesis, (change, jacobian)), ((square, deviation), sum)) in
                hypotheses.zip(sums)
            {
                let error = GpOutput::from(*y) - hypothesis.change(*change, f, &self.learned);
                *square += gain.advance(&error, jacobian, &common, deviation, sum);
            }
        }
        self.posterior((transitions * NY) as f64, &covariance)
    }

    /// The mean deviation of the hypotheses, by their likelihoods so far.
    fn likely_deviation(&self) -> GpOutput {
        let least = self.squares.iter().copied().fold(f64::INFINITY, f64::min);
        let (mut mean, mut total) = (GpOutput::zeros(), 0.0);
        for (square, deviation) in self.squares.iter().zip(&self.deviations) {
            let likelihood = (0.5 * (least - square)).exp();
            mean += deviation * likelihood;
            total += likelihood;
        }
        mean / total
    }

    /// The posterior from the sums of `n` squares, the sums of the innovations and the sum of their covariances.
    fn posterior(&mut self, n: f64, covariance: &Square) -> FrictionEstimate {
        let Some(factor) = covariance.cholesky() else {
            return FrictionEstimate::default();
        };
        let common = self.sums.map(|sum| sum.dot(&factor.solve(&sum)));
        let rest: [f64; HYPOTHESES] = std::array::from_fn(|i| self.squares[i] - common[i]);
        let least = rest.iter().copied().fold(f64::INFINITY, f64::min);
        if !least.is_finite() {
            return FrictionEstimate::default();
        }
        let scale = -0.5 / (TEMPERATURE * (least / n).max(1.0));
        let mut log_likelihood: [f64; HYPOTHESES] =
            std::array::from_fn(|i| scale * (rest[i] - least) - 2.0 * common[i].ln_1p());
        let largest = log_likelihood
            .iter()
            .copied()
            .fold(f64::NEG_INFINITY, f64::max);
        for value in &mut log_likelihood {
            *value = (*value - largest).max(LEAST_LOG_LIKELIHOOD);
        }
        let (mut most, mut likeliest) = (f64::NEG_INFINITY, 0.0);
        for (density, position) in self.density.iter_mut().zip(&self.positions) {
            *density = interpolate_hypotheses(&log_likelihood, *position);
            if *density > most {
                (most, likeliest) = (*density, *position);
            }
        }
        let shift = if most.abs() > EXTREME { most } else { 0.0 };
        for density in &mut self.density {
            *density = (*density - shift).exp();
        }
        let trapezoid = |i: usize| if i == 0 || i == POINTS - 1 { 0.5 } else { 1.0 };
        let total: f64 = (0..POINTS).map(|i| trapezoid(i) * self.density[i]).sum();
        let (mut mean, mut square, mut information) = (0.0, 0.0, 0.0);
        for (i, density) in self.density.iter().enumerate() {
            let mass = trapezoid(i) * density / total;
            mean += mass * point(i);
            square += mass * point(i) * point(i);
            let ratio = density / total * (POINTS - 1) as f64;
            if ratio > 0.0 {
                information += mass * ratio.ln();
            }
        }
        FrictionEstimate {
            mean,
            std: (square - mean * mean).max(0.0).sqrt(),
            lower: self.quantile(INTERVAL.0 * total),
            upper: self.quantile(INTERVAL.1 * total),
            information: information.max(0.0),
            log_likelihood,
            misfit: self.misfit(likeliest, &factor),
        }
    }

    /// [`FrictionEstimate::misfit`] at a position, counted in hypotheses; the sums of innovations are interpolated linearly.
    fn misfit(&self, position: f64, covariance: &Cholesky<f64, Const<NY>>) -> f64 {
        let after = self.sums.iter().skip(1);
        let between = self.sums.iter().zip(after).enumerate();
        let sum = between.fold(self.sums[0], |sum, (i, (from, to))| {
            sum + (to - from) * (position - i as f64).clamp(0.0, 1.0)
        });
        (sum.dot(&covariance.solve(&sum)) / NY as f64).min(MOST_MISFIT)
    }

    /// The point up to which the density sums to `sum`.
    fn quantile(&self, sum: f64) -> f64 {
        let mut before = 0.0;
        for (i, pair) in self.density.windows(2).enumerate() {
            let mass = 0.5 * (pair[0] + pair[1]);
            if before + mass >= sum && mass > 0.0 {
                return point(i) + (sum - before) / mass * (point(i + 1) - point(i));
            }
            before += mass;
        }
        RANGE.1
    }
}

/// Friction coefficient of the `i`-th point of the density.
fn point(i: usize) -> f64 {
    let (low, high) = RANGE;
    low + (high - low) * i as f64 / (POINTS - 1) as f64
}
