//! Settings of the residual.

use serde::{Deserialize, Serialize};

use super::range::check;
use super::{SettingsError, WeightSettings};
use crate::NY;

/// What the control step adds to the members' prediction, from the errors of the last transitions.
///
/// All arrays are for the changes of `[v_x, v_y, omega]` over one period. `egp evaluate --log` prints the values with
/// which a log is predicted best. With `std` and `measurement` zero there is no residual.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct ResidualSettings {
    /// Standard deviations of the slow disturbance, in m/s, m/s and rad/s. Default 0.
    pub std: [f64; NY],
    /// Correlation times of the disturbance, in s. Default 1.
    pub time: [f64; NY],
    /// Standard deviations of errors that are independent between periods, in m/s, m/s and rad/s. Default 0.02, 0.005,
    /// 0.002.
    pub noise: [f64; NY],
    /// Standard deviations of the noise of the measured states, in m/s, m/s and rad/s. The noise of the newest state is
    /// estimated and subtracted in the first stage. With 0, the default, it is not estimated.
    pub measurement: [f64; NY],
}

impl Default for ResidualSettings {
    fn default() -> Self {
        Self {
            std: [0.0; NY],
            time: [1.0; NY],
            noise: [0.02, 0.005, 0.002],
            measurement: [0.0; NY],
        }
    }
}

impl ResidualSettings {
    /// Checks every field.
    ///
    /// # Errors
    /// [`SettingsError::Range`] naming the first field out of range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        type Row = (&'static str, [f64; NY], &'static str, fn(f64) -> bool);
        let (std, noise) = ("in [0, 100]", WeightSettings::is_noise);
        let rows: [Row; 4] = [
            ("residual.std", self.std, std, noise),
            ("residual.time", self.time, "in [0.001, 10000] s", |v| {
                (1e-3..=1e4).contains(&v)
            }),
            ("residual.noise", self.noise, "in [1e-9, 100]", |v| {
                (1e-9..=100.0).contains(&v)
            }),
            ("residual.measurement", self.measurement, std, noise),
        ];
        for (field, values, expected, accept) in rows {
            for value in values {
                check(field, value, expected, accept)?;
            }
        }
        Ok(())
    }
}
