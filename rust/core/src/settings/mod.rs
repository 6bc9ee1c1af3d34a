//! Every number a user may choose, validated once.
//!
//! TOML form: one table per struct, every field optional, unknown fields refused.
//!
//! ```
//! use egp_core::Settings;
//! let settings = Settings::from_toml("horizon = 25\n[cost]\nlateral = 30.0")?;
//! assert_eq!(settings.cost.longitudinal, 10.0);
//! assert!(Settings::from_toml("[cost]\nlatteral = 30.0").is_err());
//! # Ok::<(), egp_core::SettingsError>(())
//! ```

mod control;
mod estimation;

use serde::{Deserialize, Serialize};

pub use control::{
    Cost, Limits, Operating, OperatingSettings, Penalty, Soft, SolverKind, SolverSettings,
};
pub use estimation::{Prior, WeightSettings};

/// Settings of the control step. Defaults drive vehicle 1 of CommonRoad, best at `dt` = 0.02 s.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Horizon `T`: number of inputs in a plan. Default: those of 0.8 s, 40 at `dt` = 0.02 s; at most 100.
    ///
    /// Chosen by experiment, near the limit and with measurement noise: a period of 0.02 s halved the lateral error
    /// of 0.05 s with the same data; 30 inputs lost the car more often than 40, and 50 brought nothing more. At 0.05
    /// s, 40 inputs lost cars at 80 % of the grip, 16 none up to 95 %.
    pub horizon: Option<usize>,
    /// Vehicle mass in kg, which turns force into the scaled input `a = F_x/m`. Default 1225.887.
    pub mass: f64,
    /// How the weights follow the surface, eq. (6).
    pub weights: WeightSettings,
    /// Where the members are linearised, eq. (15).
    pub operating: OperatingSettings,
    /// Cost of eq. (18).
    pub cost: Cost,
    /// Hard bounds on inputs and their rates.
    pub limits: Limits,
    /// Soft bounds on states and track edges.
    pub soft: Soft,
    /// QP solver.
    pub solver: SolverSettings,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            horizon: None,
            mass: 1225.887,
            weights: WeightSettings::default(),
            operating: OperatingSettings::default(),
            cost: Cost::default(),
            limits: Limits::default(),
            soft: Soft::default(),
            solver: SolverSettings::default(),
        }
    }
}

/// The default horizon, in s, and in periods at most.
const HORIZON: f64 = 0.8;
const LONGEST_DEFAULT_HORIZON: usize = 100;

/// Why settings were refused.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// Not TOML, a field of the wrong type, or a field that does not exist.
    #[error("settings are not valid TOML for this version: {0}")]
    Toml(#[from] toml::de::Error),
    /// Settings that cannot be written as TOML.
    #[error("settings cannot be written as TOML: {0}")]
    Write(#[from] toml::ser::Error),
    /// A number outside the range in which it means something.
    #[error("setting `{field}` must be {expected}, got {got}")]
    Range {
        /// Dotted name of the field.
        field: &'static str,
        /// The accepted range in words.
        expected: &'static str,
        /// The value that came.
        got: f64,
    },
}

impl Settings {
    /// Longest horizon accepted; a plan beyond it is no longer a plan but a typing error.
    pub const MAX_HORIZON: usize = 200;

    /// The horizon `T` for a period of `dt` s.
    pub fn horizon(&self, dt: f64) -> usize {
        self.horizon
            .unwrap_or_else(|| periods(HORIZON, dt, LONGEST_DEFAULT_HORIZON))
    }

    /// The same settings with those stated that by default depend on the period of `dt` s.
    #[must_use]
    pub fn at_period(mut self, dt: f64) -> Self {
        self.horizon = Some(self.horizon(dt));
        self.weights.window = Some(self.weights.window(dt));
        self
    }

    /// Reads and validates settings; fields left out keep their default.
    ///
    /// # Errors
    /// [`SettingsError::Toml`] for text that does not fit, [`SettingsError::Range`] for a bad number.
    pub fn from_toml(text: &str) -> Result<Self, SettingsError> {
        let settings: Self = toml::from_str(text)?;
        settings.validate()?;
        Ok(settings)
    }

    /// Writes all fields, so that a run's settings can be stored beside its result.
    ///
    /// # Errors
    /// [`SettingsError::Write`] if TOML cannot hold them, which no valid settings cause.
    pub fn to_toml(&self) -> Result<String, SettingsError> {
        Ok(toml::to_string(self)?)
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`SettingsError::Range`] naming the first field out of range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        if let Some(horizon) = self.horizon {
            check("horizon", horizon as f64, "in 1..=200", |h| {
                (1.0..=Self::MAX_HORIZON as f64).contains(&h)
            })?;
        }
        positive("mass", self.mass)?;
        self.weights.validate()?;
        self.operating.validate()?;
        self.cost.validate()?;
        self.limits.validate()?;
        self.soft.validate()?;
        self.solver.validate()
    }
}

/// Number of periods of `dt` in `time`, both in s: at least one, at most `most`.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped
fn periods(time: f64, dt: f64, most: usize) -> usize {
    (time / dt).round().clamp(1.0, most as f64) as usize
}

/// Refuses `got` unless it is finite and `accept`ed.
fn check(
    field: &'static str,
    got: f64,
    expected: &'static str,
    accept: impl Fn(f64) -> bool,
) -> Result<(), SettingsError> {
    if got.is_finite() && accept(got) {
        Ok(())
    } else {
        Err(SettingsError::Range {
            field,
            expected,
            got,
        })
    }
}

fn positive(field: &'static str, got: f64) -> Result<(), SettingsError> {
    check(field, got, "finite and positive", |v| v > 0.0)
}

fn not_negative(field: &'static str, got: f64) -> Result<(), SettingsError> {
    check(field, got, "finite and not negative", |v| v >= 0.0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn defaults_are_valid_and_survive_toml() {
        let settings = Settings::default();
        settings.validate().unwrap();
        assert_eq!(
            Settings::from_toml(&settings.to_toml().unwrap()).unwrap(),
            settings
        );
        assert_eq!(Settings::from_toml("").unwrap(), settings);
    }

    #[test]
    fn horizon_and_window_last_as_long_at_any_period_unless_stated() {
        for (dt, horizon, window) in [
            (0.001, 100, 64),
            (0.02, 40, 25),
            (1.0 / 30.0, 24, 15),
            (0.05, 16, 10),
            (2.0, 1, 1),
        ] {
            let settings = Settings::default().at_period(dt);
            assert_eq!(
                (settings.horizon, settings.weights.window),
                (Some(horizon), Some(window))
            );
            assert_eq!(settings.clone().at_period(0.02), settings);
        }
    }

    #[test]
    fn unknown_fields_are_refused_at_every_depth() {
        for text in [
            "horizn = 3",
            "[soft.track]\nliner = 1.0",
            "[weights.prior]\nkind = \"l1\"\nlambda = 1.0",
        ] {
            assert!(
                matches!(Settings::from_toml(text), Err(SettingsError::Toml(_))),
                "{text}"
            );
        }
    }

    #[test]
    fn bad_numbers_are_refused_by_name() {
        for (text, name) in [
            ("horizon = 0", "horizon"),
            ("mass = nan", "mass"),
            ("[limits]\na_min = 1.0", "limits.a_min"),
            ("[cost]\nlateral = -1.0", "cost.lateral"),
            ("[operating]\nyaw_at = 1.5", "operating.yaw_at"),
            ("[operating]\nyaw_at = nan", "operating.yaw_at"),
            ("[cost]\ninput = [0.0, 1.0]", "cost.input"),
            ("[weights]\nthreshold = 1.5", "weights.threshold"),
            ("[soft.track]\nlinear = 0.0", "soft.track.linear"),
        ] {
            let error = Settings::from_toml(text).unwrap_err();
            assert!(
                matches!(error, SettingsError::Range { field, .. } if field == name),
                "{text}: {error}"
            );
        }
    }
}
