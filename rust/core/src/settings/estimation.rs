//! Settings of the weights, eq. (6).

use serde::{Deserialize, Serialize};

use super::range::{check, not_negative};
use super::{SettingsError, periods};
use crate::vehicle::SLIPPERY;
use crate::{Library, NY};

/// How the ensemble's weights follow the last transitions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct WeightSettings {
    /// Window `K`: number of past transitions, 1 to 1000; requests hold at most 64. Default: 0.5 s, which are 25 periods of
    /// 0.02 s, and shorter for small vehicles, but at most 64 periods.
    pub window: Option<usize>,
    /// Weigh the window's errors by the inverse of their covariance, so that m/s and rad/s may be added. Default
    /// true; false is the paper's `S = I`, with which the weights also follow windows without information.
    pub whiten: bool,
    /// Largest expected standard deviations of the noise of the measured `[v_x, v_y, omega]`, m/s, m/s, rad/s. A measured
    /// change is the difference of two measured states, so that it contains the noise of both, and shares each with a
    /// neighbouring change; the members' own noise is added. Each window uses the most likely of 1, 0.3 and 0.1 times these
    /// values, with all or half of the members' noise ([`WindowNoise`](crate::weights::WindowNoise)). The estimator of the
    /// friction uses the stated values. With `whiten = false` no other computation does. Default: the library's
    /// `measurement_noise`, and without that 0.03, 0.03, 0.005, what an inertial system aided by satellites gives.
    pub measurement: Option<[f64; NY]>,
    /// Prior on the change of the weights. Default quadratic with lambda 100.
    pub prior: Prior,
    /// What each member with a positive weight costs, in nats of the window's log-likelihood: blends of one or two members
    /// that explain the window nearly as well as the weights of eq. (6) replace them
    /// ([`WeightEstimator::select`](crate::weights::WeightEstimator::select)). Positive values need `whiten` and the
    /// quadratic prior. Default: 0.5 with these two if a member has a friction below 0.5, otherwise 0, which is eq. (6).
    pub member_penalty: Option<f64>,
    /// Members with at most this weight are not evaluated in the control model. The other weights are scaled to sum to 1,
    /// and the weight that was left out is in the reply. Weights of exactly zero are those at the border of the simplex.
    /// Default 1e-3.
    pub threshold: f64,
    /// At most this many members are evaluated in the control model, the heaviest first. Default 8.
    pub max_active: usize,
}

/// The term of eq. (6) that keeps the weights near the previous ones.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(
    tag = "kind",
    rename_all = "lowercase",
    deny_unknown_fields,
    expecting = "a table with `kind`"
)]
pub enum Prior {
    /// `lambda ||w - w_prev||²`: unique weights for any data.
    Quadratic {
        /// Strength, in squared whitened errors. Default 100.
        #[serde(default = "default_lambda")]
        lambda: f64,
    },
    /// `alpha ||w - w_prev||_1`, the paper's: small errors change nothing at all.
    L1 {
        /// Strength, in squared whitened errors.
        alpha: f64,
    },
}

/// The default penalty of a member in nats, if a member is slippery.
const MEMBER_PENALTY: f64 = 0.5;
/// The default window, in s, and in transitions at most.
const WINDOW: f64 = 0.5;
const LONGEST_DEFAULT_WINDOW: usize = 64;
/// The default noise of measured states if the library states none, in m/s, m/s and rad/s.
const MEASUREMENT: [f64; NY] = [0.03, 0.03, 0.005];
/// Largest standard deviation accepted.
const MAX_NOISE: f64 = 100.0;

fn default_lambda() -> f64 {
    100.0
}

impl Default for WeightSettings {
    fn default() -> Self {
        Self {
            window: None,
            whiten: true,
            measurement: None,
            prior: Prior::Quadratic {
                lambda: default_lambda(),
            },
            member_penalty: None,
            threshold: 1e-3,
            max_active: 8,
        }
    }
}

impl WeightSettings {
    /// Longest window accepted.
    pub const MAX_WINDOW: usize = 1000;

    /// The window `K` with a library.
    ///
    /// By default it is 0.5 s for a full-size vehicle, and shorter in proportion to the root of the
    /// [scale](egp_parameters::VehicleParameters::scale): vehicles of similar shape pass a border between surfaces, and excite
    /// their tyres, in times that are proportional to the root of their size.
    pub fn window(&self, library: &Library) -> usize {
        self.window_of(library.dt(), library.vehicle().scale())
    }

    /// As [`Self::window`], for a period of `dt` s and a vehicle of this scale.
    pub(crate) fn window_of(&self, dt: f64, scale: f64) -> usize {
        self.window
            .unwrap_or_else(|| periods(WINDOW * scale.sqrt(), dt, LONGEST_DEFAULT_WINDOW))
    }

    /// What a member with a positive weight costs, in nats, if the most slippery member has the coefficient `friction`.
    pub fn member_penalty(&self, friction: f64) -> f64 {
        self.member_penalty.unwrap_or({
            if friction < SLIPPERY && self.has_likelihood() {
                MEMBER_PENALTY
            } else {
                0.0
            }
        })
    }

    /// Whether weights minimise a misfit of whitened errors with a quadratic prior, so that log-likelihoods can be compared.
    fn has_likelihood(&self) -> bool {
        self.whiten && matches!(self.prior, Prior::Quadratic { .. })
    }

    /// Standard deviations of the noise of the measured states: these settings', otherwise those that the library
    /// states, otherwise the default.
    pub fn measurement(&self, library: Option<[f64; NY]>) -> [f64; NY] {
        self.measurement.or(library).unwrap_or(MEASUREMENT)
    }

    /// Whether a number is accepted as the standard deviation of a measured state's noise: 0 to 100.
    pub(crate) fn is_noise(std: f64) -> bool {
        (0.0..=MAX_NOISE).contains(&std)
    }

    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        if let Some(window) = self.window {
            check("weights.window", window as f64, "from 1 to 1000", |k| {
                (1.0..=Self::MAX_WINDOW as f64).contains(&k)
            })?;
        }
        for std in self.measurement.into_iter().flatten() {
            check("weights.measurement", std, "in [0, 100]", Self::is_noise)?;
        }
        match self.prior {
            Prior::Quadratic { lambda } => not_negative("weights.prior.lambda", lambda)?,
            Prior::L1 { alpha } => not_negative("weights.prior.alpha", alpha)?,
        }
        if let Some(penalty) = self.member_penalty {
            not_negative("weights.member_penalty", penalty)?;
            check(
                "weights.member_penalty",
                penalty,
                "0 with `weights.whiten = false` and with the L1 prior",
                |penalty| penalty == 0.0 || self.has_likelihood(),
            )?;
        }
        check("weights.threshold", self.threshold, "in [0, 0.1]", |v| {
            (0.0..=0.1).contains(&v)
        })?;
        check(
            "weights.max_active",
            self.max_active as f64,
            "at least 1",
            |v| v >= 1.0,
        )
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_window_of_small_vehicles_is_shorter() {
        let window = |scale| WeightSettings::default().window_of(0.02, scale);
        assert_eq!([1.0, 0.25, 0.16, 1e-6].map(window), [25, 13, 10, 1]);
    }

    #[test]
    fn members_have_a_penalty_if_one_is_slippery_and_weights_have_a_likelihood() {
        let penalty = |text: &str, friction| {
            let weights: WeightSettings = toml::from_str(text).unwrap();
            weights.member_penalty(friction)
        };
        assert_eq!(
            [0.5, 0.49].map(|friction| penalty("", friction)),
            [0.0, 0.5]
        );
        for (text, expected) in [
            ("whiten = false", 0.0),
            ("prior = { kind = \"l1\", alpha = 1e-5 }", 0.0),
            ("member_penalty = 2", 2.0),
        ] {
            assert_eq!(penalty(text, 0.1), expected, "{text}");
        }
    }
}
