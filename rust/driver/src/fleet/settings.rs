//! Settings of the exchange with a fleet's map.

use std::time::Duration;

use egp_wire::keys::NameError;
use thiserror::Error;

/// A setting that is out of range.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum FleetSettingsError {
    /// See [`FleetSettings::lifetime`].
    #[error("expected a positive number of seconds for lifetime, got {0}")]
    Lifetime(f64),
    /// See [`FleetSettings::timeout`].
    #[error("expected a timeout of at most a day, got {0:?}")]
    Timeout(Duration),
    /// The name of the road with the length of its cells, which follows it in keys, is too long.
    #[error(transparent)]
    Road(#[from] NameError),
}

/// Settings of a [`crate::FleetExchange`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FleetSettings {
    /// Time in s in which a report loses information, as the map service has it: reports age while the service is silent.
    /// Default 1800.
    pub lifetime: f64,
    /// How long an answer, [`crate::FleetExchange::fetch`] and [`crate::FleetExchange::finish`] may take, at most a day. Default
    /// 3 s.
    pub timeout: Duration,
}

impl Default for FleetSettings {
    fn default() -> Self {
        Self {
            lifetime: 1800.0,
            timeout: Duration::from_secs(3),
        }
    }
}
