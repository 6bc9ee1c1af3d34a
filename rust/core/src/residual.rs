//! The residual: a slow disturbance that no member predicts, such as bank, slope, wind, load or drift.
//!
//! The error of the ensemble over transition `k` is modelled, for each output alone, as
//!
//! ```text
//! e_k = b_k + v_k + n_{k+1} - n_k,      b_{k+1} = a b_k + sqrt(1 - a²) s xi_k,      a = exp(-dt / time)
//! ```
//!
//! with the disturbance `b` of standard deviation `s`, independent errors `v` of the model, and the noise `n` of the
//! measured states, which enters consecutive changes with opposite signs. A Kalman filter over the window's transitions,
//! started from the stationary distribution, estimates `b` and the noise of the newest state (Anderson and Moore, *Optimal
//! Filtering*, 1979, chapter 5, for process and measurement noise that are correlated). Innovations are limited to three
//! standard deviations, because measured changes have outliers, and the disturbance to `3 s`.
//!
//! The filter needs no state besides the window that a request contains. On a log of an oval a window of 0.5 s predicted no
//! worse than one of 4 s.

use crate::settings::ResidualSettings;
use crate::{GpOutput, NY};

/// Standard deviations to which innovations and the disturbance are limited.
const LIMIT: f64 = 3.0;

/// The filter for one library and settings: its gains depend only on the number of transitions.
#[derive(Debug, Clone)]
pub struct ResidualFilter {
    /// One entry for each number of transitions before, `0..=window`.
    steps: Vec<Gains>,
    decay: GpOutput,
    std: GpOutput,
}

/// Gains for the next transition.
#[derive(Debug, Clone, Copy)]
struct Gains {
    disturbance: GpOutput,
    noise: GpOutput,
    /// Largest innovation that counts.
    limit: GpOutput,
    /// Variance of the disturbance before this transition is known.
    variance: GpOutput,
}

/// The residual after the last transition of a window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    disturbance: GpOutput,
    noise: GpOutput,
    variance: GpOutput,
    decay: GpOutput,
    std: GpOutput,
}

impl ResidualFilter {
    /// The filter at a period of `dt` s for windows of at most `window` transitions; none if all standard deviations of
    /// the disturbance and of the measured states' noise are zero.
    pub fn new(settings: &ResidualSettings, dt: f64, window: usize) -> Option<Self> {
        let variance = |std: [f64; NY]| GpOutput::from(std).map(|std| std * std);
        let (b, v, n) = (
            variance(settings.std),
            variance(settings.noise),
            variance(settings.measurement),
        );
        let decay = GpOutput::from(settings.time).map(|time| (-dt / time).exp());
        // Variances and covariance of the disturbance `b` and the newest noise `n`.
        let mut bb = b;
        let (mut bn, mut nn) = (GpOutput::zeros(), n);
        let mut steps = Vec::with_capacity(window + 1);
        for _ in 0..=window {
            let innovation = bb - bn * 2.0 + nn + v + n;
            let gains = Gains {
                disturbance: decay.component_mul(&(bb - bn)).component_div(&innovation),
                noise: n.component_div(&innovation),
                limit: innovation.map(|variance| LIMIT * variance.sqrt()),
                variance: bb,
            };
            steps.push(gains);
            let reduction =
                |a: &GpOutput, b: &GpOutput| a.component_mul(b).component_mul(&innovation);
            let decay_squared = decay.component_mul(&decay);
            bb = b + decay_squared.component_mul(&(bb - b))
                - reduction(&gains.disturbance, &gains.disturbance);
            bn = -reduction(&gains.disturbance, &gains.noise);
            nn = n - reduction(&gains.noise, &gains.noise);
        }
        (b.max() + n.max() > 0.0).then_some(Self {
            steps,
            decay,
            std: settings.std.into(),
        })
    }

    /// The residual after consecutive transitions with these errors, measured less predicted, oldest first. Transitions
    /// beyond the window are ignored.
    pub fn estimate(&self, errors: impl Iterator<Item = GpOutput>) -> Residual {
        let (mut disturbance, mut noise) = (GpOutput::zeros(), GpOutput::zeros());
        let window = self.steps.len() - 1;
        let mut count = 0;
        for (gains, error) in self.steps[..window].iter().zip(errors) {
            let innovation = error - disturbance + noise;
            let innovation = innovation.zip_map(&gains.limit, |e, most| e.clamp(-most, most));
            let next = self.decay.component_mul(&disturbance)
                + gains.disturbance.component_mul(&innovation);
            disturbance = next.zip_map(&self.std, |b, std| b.clamp(-LIMIT * std, LIMIT * std));
            noise = gains.noise.component_mul(&innovation);
            count += 1;
        }
        Residual {
            disturbance,
            noise,
            variance: self.steps[count].variance,
            decay: self.decay,
            std: self.std,
        }
    }
}

impl Residual {
    /// The disturbance: the change over a period from now that no member predicts.
    pub fn disturbance(&self) -> GpOutput {
        self.disturbance
    }

    /// What to add to the change that the ensemble predicts for each transition from now on, and its variance:
    /// `a^t b`, without the newest state's noise at `t` = 0, and `s² + a^(2t) (var b - s²)`.
    pub fn ahead(&self) -> impl Iterator<Item = (GpOutput, GpOutput)> {
        let stationary = self.std.component_mul(&self.std);
        let (decay, square) = (self.decay, self.decay.component_mul(&self.decay));
        let first = (self.disturbance, self.variance - stationary, self.noise);
        std::iter::successors(Some(first), move |(b, variance, _)| {
            let next = (b.component_mul(&decay), variance.component_mul(&square));
            Some((next.0, next.1, GpOutput::zeros()))
        })
        .map(move |(b, variance, noise)| (b - noise, variance + stationary))
    }
}
