//! The configuration of the map service.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;

use egp_map::MergeSettings;
use egp_wire::TILE_ORIGINS;
use serde::Deserialize;

use super::store::MapLimits;
use crate::config::{DEFAULT_LOG, address};
use crate::config_error::ConfigError;

/// The configuration of a map service, in TOML. Unknown keys are errors.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MapConfig {
    /// Folder of the roads' files, which is made if it does not exist. Without one, the map is lost when the service ends.
    pub folder: Option<PathBuf>,
    /// Time in s in which the information of a contribution falls to 1/e. Default 1800.
    pub lifetime: f64,
    /// Largest logarithm of a likelihood ratio that one vehicle contributes to a cell, nats. Default 6.
    pub capacity: f64,
    /// Vehicles that contribute to a tile; one with newer evidence replaces the oldest. Default 16.
    pub vehicles: usize,
    /// Tiles to which one vehicle contributes. Default 4096.
    pub tiles: usize,
    /// Roads to which one vehicle contributes. Default 32.
    pub roads: usize,
    /// Contributions in all, of about 3.3 kB each. Default 65536.
    pub contributions: usize,
    /// Least time between two publications of the changes of a road, ms. Default 500.
    pub publish_ms: u64,
    /// Time between two writings of changed roads, ms. Default 10000.
    pub save_ms: u64,
    /// Address for `/health`, `/ready` and `/metrics` over HTTP, such as `127.0.0.1:9465`. Default: none.
    #[serde(deserialize_with = "address")]
    pub http: Option<SocketAddr>,
    /// What to log, with the same default as [`crate::ServiceConfig::log`].
    pub log: String,
    /// Whether each log line is a JSON object instead of text. Default false.
    pub log_json: bool,
    /// A zenoh JSON5 file that replaces this service's defaults.
    pub zenoh_file: Option<PathBuf>,
    /// Single zenoh settings, key path to JSON5 value; they override the defaults or the file.
    pub zenoh: BTreeMap<String, String>,
}

impl Default for MapConfig {
    fn default() -> Self {
        let merge = MergeSettings::default();
        Self {
            folder: None,
            lifetime: merge.lifetime,
            capacity: merge.capacity,
            vehicles: 16,
            tiles: 4096,
            roads: 32,
            contributions: 65536,
            publish_ms: 500,
            save_ms: 10_000,
            http: None,
            log: DEFAULT_LOG.to_owned(),
            log_json: false,
            zenoh_file: None,
            zenoh: BTreeMap::new(),
        }
    }
}

impl MapConfig {
    /// Reads and validates a configuration.
    ///
    /// # Errors
    /// [`ConfigError`] naming the key at fault.
    pub fn from_toml(text: &str) -> Result<Self, ConfigError> {
        let config: Self = toml::from_str(text)?;
        config.validate()?;
        Ok(config)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`ConfigError::Range`] for the first one at fault.
    pub fn validate(&self) -> Result<(), ConfigError> {
        if !(1.0..=1e9).contains(&self.lifetime) {
            return Err(ConfigError::range("lifetime", "1 to 1e9 s", &self.lifetime));
        }
        if !(1.0..=8.0).contains(&self.capacity) {
            return Err(ConfigError::range(
                "capacity",
                "1 to 8 nats",
                &self.capacity,
            ));
        }
        if !(1..=TILE_ORIGINS).contains(&self.vehicles) {
            return Err(ConfigError::range(
                "vehicles",
                "from 1 to 64",
                &self.vehicles,
            ));
        }
        if !(1..=1_000_000).contains(&self.tiles) {
            return Err(ConfigError::range(
                "tiles",
                "from 1 to 1000000",
                &self.tiles,
            ));
        }
        if !(1..=1_000_000).contains(&self.roads) {
            return Err(ConfigError::range(
                "roads",
                "from 1 to 1000000",
                &self.roads,
            ));
        }
        if !(1..=10_000_000).contains(&self.contributions) {
            return Err(ConfigError::range(
                "contributions",
                "from 1 to 10000000",
                &self.contributions,
            ));
        }
        if !(10..=3_600_000).contains(&self.publish_ms) {
            return Err(ConfigError::range(
                "publish_ms",
                "in 10..=3600000",
                &self.publish_ms,
            ));
        }
        if !(10..=3_600_000).contains(&self.save_ms) {
            return Err(ConfigError::range(
                "save_ms",
                "in 10..=3600000",
                &self.save_ms,
            ));
        }
        Ok(())
    }

    pub(crate) fn merge(&self) -> MergeSettings {
        MergeSettings {
            capacity: self.capacity,
            lifetime: self.lifetime,
        }
    }

    pub(crate) fn limits(&self) -> MapLimits {
        MapLimits {
            contributions: self.contributions,
            vehicles: self.vehicles,
            tiles: self.tiles,
            roads: self.roads,
        }
    }
}
