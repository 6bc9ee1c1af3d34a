//! The configuration of a client.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use egp_driver::{DriverConfig, RunKey};
use egp_gate::Limits;
use egp_wire::keys::NameError;
use egp_wire::{KeyError, KeyFileError, KeyRing, VehicleKey};
use thiserror::Error;

/// Why the secret key of a vehicle cannot be used.
#[derive(Debug, Error)]
pub enum VehicleKeyError {
    /// The file cannot be used.
    #[error(transparent)]
    File(#[from] KeyFileError),
    /// The file has no key of this vehicle.
    #[error("{path}: {source}")]
    Missing {
        /// The file.
        path: String,
        /// Which key is missing.
        source: KeyError,
    },
}

/// Configuration of a [`crate::VehicleClient`].
#[derive(Clone, Debug)]
pub struct VehicleConfig {
    /// Name, budget, actuator limits and gate of the vehicle.
    pub driver: DriverConfig,
    /// The vehicle's secret key, which [`VehicleConfig::with_key`] reads. Each connection is a run of its own with this key,
    /// in place of `driver.key`. Default none.
    pub key: Option<VehicleKey>,
    /// Routers or replicas to connect to, such as `tcp/host:7447`.
    pub connect: Vec<String>,
    /// How long to wait for a replica when connecting. Default 10 s.
    pub patience: Duration,
    /// A zenoh JSON5 file that replaces this client's defaults, for TLS and the like. `connect`, unless empty, replaces
    /// the file's endpoints.
    pub zenoh_file: Option<PathBuf>,
    /// Whether the client publishes how the vehicle drives, for `egp monitor` and other displays. Default false.
    pub publish_status: bool,
    /// File to which the spans of control steps are appended, which `docs/deploying.md` describes. Default none.
    pub traces: Option<PathBuf>,
    /// Share of the traces that is written, from 0 to 1. A service with the same share writes the same traces. Default 1.
    pub traces_share: f64,
    /// Single zenoh settings, key path to JSON5 value; they override the defaults or the file.
    pub zenoh: BTreeMap<String, String>,
}

/// How a client reaches services, as the fields of [`VehicleConfig`] and of [`crate::FleetMapConfig`] state it.
pub(crate) struct Access<'a> {
    pub(crate) connect: &'a [String],
    pub(crate) patience: Duration,
    pub(crate) zenoh_file: Option<&'a Path>,
    pub(crate) zenoh: &'a BTreeMap<String, String>,
}

impl VehicleConfig {
    pub(crate) fn access(&self) -> Access<'_> {
        Access {
            connect: &self.connect,
            patience: self.patience,
            zenoh_file: self.zenoh_file.as_deref(),
            zenoh: &self.zenoh,
        }
    }

    /// Defaults for a vehicle of this name with these actuator limits that connects to these endpoints.
    ///
    /// # Errors
    /// [`NameError`] if fleet or vehicle is not 1 to 64 of the characters `A-Z a-z 0-9 . _ -`.
    pub fn new(
        fleet: &str,
        vehicle: &str,
        limits: Limits,
        connect: &[&str],
    ) -> Result<Self, NameError> {
        Ok(Self {
            driver: DriverConfig::new(fleet, vehicle, limits)?,
            key: None,
            connect: connect.iter().map(ToString::to_string).collect(),
            patience: Duration::from_secs(10),
            zenoh_file: None,
            publish_status: false,
            traces: None,
            traces_share: 1.0,
            zenoh: BTreeMap::new(),
        })
    }

    /// The same vehicle with its secret key from a file that `egp keys` wrote, with which it seals its questions and
    /// recognises its answers.
    ///
    /// # Errors
    /// [`VehicleKeyError`] naming the file.
    pub fn with_key(mut self, file: &Path) -> Result<Self, VehicleKeyError> {
        let ring = KeyRing::read(file)?;
        let key = ring.get(&self.driver.fleet, &self.driver.vehicle);
        let key = key
            .map_err(|source| VehicleKeyError::Missing {
                path: file.display().to_string(),
                source,
            })?
            .clone();
        self.key = Some(key);
        Ok(self)
    }

    /// The driver's configuration for one connection, with a random number of the run if there is a key: a service answers each
    /// number of a run once, and every driver counts its questions from 1.
    pub(crate) fn driver_of_a_run(&self) -> Result<DriverConfig, getrandom::Error> {
        let mut driver = self.driver.clone();
        if let Some(key) = self.key.clone() {
            let run = getrandom::u64()?;
            driver.key = Some(RunKey { key, run });
        }
        Ok(driver)
    }

    /// The same vehicle with the options of a command line: the endpoints that are given, otherwise those of the zenoh
    /// file, otherwise `tcp/127.0.0.1:7447`.
    #[must_use]
    pub fn reached_by(mut self, connect: &[String], zenoh_file: Option<&Path>) -> Self {
        self.connect = connect.to_vec();
        if connect.is_empty() && zenoh_file.is_none() {
            self.connect.push("tcp/127.0.0.1:7447".to_owned());
        }
        self.zenoh_file = zenoh_file.map(Path::to_owned);
        self
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use egp_parameters::VehicleParameters;

    use super::*;

    #[test]
    fn each_connection_with_a_key_is_a_run_of_its_own() {
        let limits = Limits::of(&VehicleParameters::FORD_ESCORT);
        let mut config = VehicleConfig::new("test", "car", limits, &[]).unwrap();
        assert_eq!(config.driver_of_a_run().unwrap().key, None);
        let ring = KeyRing::parse(&format!("test/car {}", "07".repeat(32))).unwrap();
        let own = ring.get(&config.driver.fleet, &config.driver.vehicle);
        let own = own.unwrap().clone();
        config.key = Some(own.clone());
        let [first, second] = [(); 2].map(|()| config.driver_of_a_run().unwrap().key.unwrap());
        assert_eq!([&first.key, &second.key], [&own, &own]);
        assert_ne!(first.run, second.run);
        // A key that only the driver's configuration states is used as it is.
        config.key = None;
        config.driver.key = Some(second.clone());
        assert_eq!(config.driver_of_a_run().unwrap().key, Some(second));
    }
}
