//! Every number a user may choose, validated once.
//!
//! TOML form: one table per struct. Every field is optional, except `kind` in `[weights.prior]` ([`Prior`]), and `alpha` there
//! if the kind is `l1`. Unknown fields are errors.
//!
//! ```
//! use egp_core::Settings;
//! let settings = Settings::from_toml("horizon = 25\n[cost]\nlateral = 30.0")?;
//! assert_eq!(settings.cost.lateral, Some(30.0));
//! assert!(Settings::from_toml("[cost]\nlatteral = 30.0").is_err());
//! # Ok::<(), egp_core::SettingsError>(())
//! ```

mod control;
mod cost;
mod estimation;
mod horizon;
mod range;
mod residual;

use egp_parameters::VehicleParameters;
use serde::{Deserialize, Serialize};

pub use control::{
    InputBounds, Operating, OperatingSettings, PenaltySettings, Soft, SolverKind, SolverSettings,
};
pub use cost::{Cost, ScaledWeights};
pub use estimation::{Prior, WeightSettings};
pub use residual::ResidualSettings;

use crate::{Library, NY};
use horizon::default_horizon;
use range::check;

/// Settings of the control step.
///
/// What describes the vehicle is by default that of the library ([`Settings::vehicle`]). The other defaults were chosen
/// with CommonRoad's vehicle 1 at `dt` = 0.02 s, and follow the [scale](VehicleParameters::scale) of smaller vehicles.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct Settings {
    /// Horizon `T`: number of inputs in a plan, 1 to 200; requests hold at most 128. Default: 0.8 s, which are 40 periods of
    /// 0.02 s, shorter for small vehicles, and longer for a library with a member of a friction below 0.5, but at most 120
    /// periods ([`Settings::horizon`](Self::horizon())).
    ///
    /// Measured near the friction limit with measurement noise. With the same data, a period of 0.02 s halves the lateral error
    /// of a period of 0.05 s. At 0.02 s, 30 inputs lose the car more often than 40, and 50 are not better. At 0.05 s, 40 inputs
    /// lose cars at 80 % of the grip, and 16 lose none up to 95 %.
    pub horizon: Option<usize>,
    /// Vehicle mass in kg, which turns force into the scaled input `a = F_x/m`. Default: the library's `mass`.
    pub mass: Option<f64>,
    /// Time in s by which the measured `[v_x, v_y, omega]` are late; positions, yaw and steering angle are those of now.
    ///
    /// The step pairs the measured changes with the inputs that caused them, and predicts the present state by the
    /// inputs since, which the window must hold: a window that is shorter than the delay is an error when a workspace is made.
    /// The oldest changes of a window, whose inputs came before it, are not used. Default: the library's
    /// `measurement_delay`, and without that 0, which changes nothing; at most 0.5.
    pub measurement_delay: Option<f64>,
    /// How the weights follow the surface, eq. (6).
    pub weights: WeightSettings,
    /// What is added to the members' prediction.
    pub residual: ResidualSettings,
    /// Where the members are linearised, eq. (15).
    pub operating: OperatingSettings,
    /// Cost of eq. (18).
    pub cost: Cost,
    /// Hard bounds on inputs and their rates.
    pub limits: InputBounds,
    /// Soft bounds on states and track edges.
    pub soft: Soft,
    /// QP solver.
    pub solver: SolverSettings,
}

/// Longest delay of measured states accepted, in s.
const MAX_DELAY: f64 = 0.5;

/// Why settings are not valid.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// Not TOML, a field of the wrong type, or a field that does not exist.
    #[error("settings cannot be used: {0}")]
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
    /// Longest accepted horizon. A larger number is most likely a typing error.
    pub const MAX_HORIZON: usize = 200;

    /// The horizon `T` with a library.
    ///
    /// By default it is 0.8 s for a full-size vehicle, and shorter in proportion to the root of the
    /// [scale](VehicleParameters::scale): vehicles of similar shape move alike in times that are proportional to the root of
    /// their size. With a member whose friction `mu` is below 0.5 it is longer in proportion to `mu^-2/3`: tyres that transmit
    /// less need longer to move the vehicle back to its path.
    pub fn horizon(&self, library: &Library) -> usize {
        self.horizon.unwrap_or_else(|| {
            let scale = self.vehicle(library.vehicle()).scale();
            default_horizon(library.dt(), library.least_friction(), scale)
        })
    }

    /// The vehicle to control: the library's, with what these settings state in place of it.
    pub fn vehicle(&self, library: &VehicleParameters) -> VehicleParameters {
        let (limits, soft) = (&self.limits, &self.soft);
        VehicleParameters {
            mass: self.mass.unwrap_or(library.mass),
            l_f: soft.front.unwrap_or(library.l_f),
            a_min: limits.a_min.unwrap_or(library.a_min),
            a_max: limits.a_max.unwrap_or(library.a_max),
            power: limits.power.unwrap_or(library.power),
            a_slew: limits.a_slew.unwrap_or(library.a_slew),
            steering_angle: soft.delta.unwrap_or(library.steering_angle),
            steering_rate: limits.delta_dot.unwrap_or(library.steering_rate),
            steering_slew: limits.delta_dot_slew.unwrap_or(library.steering_slew),
            peak_slip: soft.slip.unwrap_or(library.peak_slip),
            ..*library
        }
    }

    /// The delay of the measured `[v_x, v_y, omega]` in s: these settings', otherwise the library's, otherwise 0.
    pub fn measurement_delay(&self, library: Option<f64>) -> f64 {
        self.measurement_delay.or(library).unwrap_or(0.0)
    }

    /// Whether a number is accepted as the delay of measured states: 0 to 0.5 s.
    pub(crate) fn is_delay(seconds: f64) -> bool {
        (0.0..=MAX_DELAY).contains(&seconds)
    }

    /// The same settings with every value stated that by default depends on the library: on its period of `dt` s, on its
    /// least `friction`, on the vehicle it was trained for and its size, or on noise and delay of the measured states that it
    /// states.
    /// `soft.slip` stays as it is, because its default differs between the members.
    #[must_use]
    pub fn complete(
        mut self,
        dt: f64,
        friction: f64,
        library: &VehicleParameters,
        measurement_noise: Option<[f64; NY]>,
        measurement_delay: Option<f64>,
    ) -> Self {
        let vehicle = self.vehicle(library);
        let horizon = || default_horizon(dt, friction, vehicle.scale());
        self.horizon = Some(self.horizon.unwrap_or_else(horizon));
        self.weights.window = Some(self.weights.window_of(dt, library.scale()));
        self.weights.member_penalty = Some(self.weights.member_penalty(friction));
        self.weights.measurement = Some(self.weights.measurement(measurement_noise));
        self.measurement_delay = Some(self.measurement_delay(measurement_delay));
        self.mass = Some(vehicle.mass);
        self.limits = InputBounds {
            a_min: Some(vehicle.a_min),
            a_max: Some(vehicle.a_max),
            power: Some(vehicle.power),
            delta_dot: Some(vehicle.steering_rate),
            a_slew: Some(vehicle.a_slew),
            delta_dot_slew: Some(vehicle.steering_slew),
        };
        let scale = vehicle.scale();
        self.operating.complete(scale);
        self.cost.complete(scale);
        self.soft.complete(scale);
        self.soft.delta = Some(vehicle.steering_angle);
        self.soft.front = Some(vehicle.l_f);
        self.soft.edge_margin = Some(self.soft.edge_margin(vehicle.width));
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
            check("horizon", horizon as f64, "from 1 to 200", |h| {
                (1.0..=Self::MAX_HORIZON as f64).contains(&h)
            })?;
        }
        if let Some(mass) = self.mass {
            check("mass", mass, "in [0.01, 1e6] kg", |mass| {
                (0.01..=1e6).contains(&mass)
            })?;
        }
        if let Some(delay) = self.measurement_delay {
            check("measurement_delay", delay, "in [0, 0.5] s", Self::is_delay)?;
        }
        self.weights.validate()?;
        self.residual.validate()?;
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const CAR: VehicleParameters = VehicleParameters::FORD_ESCORT;

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
            (0.001, 120, 64),
            (0.02, 40, 25),
            (1.0 / 30.0, 24, 15),
            (0.05, 16, 10),
            (2.0, 1, 1),
        ] {
            let settings = Settings::default().complete(dt, 1.0, &CAR, None, None);
            assert_eq!(
                (settings.horizon, settings.weights.window),
                (Some(horizon), Some(window))
            );
            assert_eq!(
                settings.clone().complete(0.02, 1.0, &CAR, None, None),
                settings
            );
        }
    }

    #[test]
    fn the_library_says_what_is_controlled_unless_the_settings_do() {
        let settings = Settings::from_toml(
            "mass = 1400.0\n[limits]\na_max = 4.0\ndelta_dot = 0.3\n[soft]\nslip = 0.2\nfront = 1.3",
        )
        .unwrap();
        let library = VehicleParameters::BMW_320I;
        let stated = VehicleParameters {
            mass: 1400.0,
            a_max: 4.0,
            steering_rate: 0.3,
            peak_slip: 0.2,
            l_f: 1.3,
            ..library
        };
        assert_eq!(settings.vehicle(&library), stated);
        assert_eq!(Settings::default().vehicle(&library), library);
        // What is complete no longer depends on the library, but for what no setting can state.
        let complete = settings.complete(0.02, 1.0, &library, None, None);
        let other = complete.vehicle(&CAR);
        assert_eq!(
            VehicleParameters {
                yaw_inertia: library.yaw_inertia,
                l_r: library.l_r,
                width: library.width,
                ..other
            },
            stated
        );
        assert_eq!(complete.soft.edge_margin, Some(0.805 + 0.263));
        // A narrow vehicle keeps a quarter of its width from the edge.
        assert_eq!(Soft::default().edge_margin(0.28), 0.14 + 0.07);
    }

    #[test]
    fn with_the_demo_vehicle_the_defaults_are_those_of_the_published_results() {
        let settings = Settings::default().complete(0.02, 1.0, &CAR, None, None);
        let InputBounds {
            a_min,
            a_max,
            power,
            delta_dot,
            a_slew,
            delta_dot_slew,
        } = settings.limits;
        assert_eq!(
            (settings.mass, a_min, a_max),
            (Some(1225.887), Some(-8.0), Some(6.0))
        );
        assert_eq!((power, delta_dot), (Some(54.7), Some(0.4)));
        assert_eq!((a_slew, delta_dot_slew), (Some(60.0), Some(8.0)));
        let soft = settings.soft;
        assert_eq!((soft.delta, soft.slip), (Some(0.91), None));
        assert_eq!((soft.front, soft.edge_margin), (Some(0.9), Some(1.1)));
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
            ("mass = 1e-300", "mass"),
            ("[cost]\nlateral = 1e300", "cost.lateral"),
            ("[cost]\nlongitudinal = 1.1e5", "cost.longitudinal"),
            ("[cost]\nlateral = 1.1e5", "cost.lateral"),
            ("[cost]\nv_x = 1.1e5", "cost.v_x"),
            ("[cost]\npsi = 1.1e5", "cost.psi"),
            ("[cost]\nterminal = 1.1e3", "cost.terminal"),
            ("[cost]\nproximal = 1.1e5", "cost.proximal"),
            ("[operating]\nv_x_min = 100.1", "operating.v_x_min"),
            ("[soft]\nedge_margin = 1000.1", "soft.edge_margin"),
            ("[cost]\ninput = [1e-300, 1.0]", "cost.input"),
            ("[limits]\na_min = -1e300", "limits.a_min"),
            ("[limits]\na_min = 1.0", "limits.a_min"),
            ("[cost]\nlateral = -1.0", "cost.lateral"),
            ("[operating]\nyaw_at = 1.5", "operating.yaw_at"),
            ("[operating]\nyaw_at = nan", "operating.yaw_at"),
            ("[cost]\ninput = [0.0, 1.0]", "cost.input"),
            ("[weights]\nthreshold = 1.5", "weights.threshold"),
            ("weights.member_penalty = -1", "weights.member_penalty"),
            ("weights.member_penalty = nan", "weights.member_penalty"),
            (
                "[weights]\nmember_penalty = 1\nwhiten = false",
                "weights.member_penalty",
            ),
            (
                "[weights]\nmember_penalty = 1\nprior = { kind = \"l1\", alpha = 0 }",
                "weights.member_penalty",
            ),
            ("[residual]\nstd = [0.0, -1.0, 0.0]", "residual.std"),
            (
                "[residual]\nmeasurement = [0.0, 0.0, 1e3]",
                "residual.measurement",
            ),
            ("[residual]\ntime = [0.0, 1.0, 1.0]", "residual.time"),
            ("[residual]\nnoise = [1.0, 1.0, nan]", "residual.noise"),
            ("[soft.track]\nlinear = 1.1e5", "soft.track.linear"),
        ] {
            let error = Settings::from_toml(text).unwrap_err();
            assert!(
                matches!(error, SettingsError::Range { field, .. } if field == name),
                "{text}: {error}"
            );
        }
    }
}
