//! The configuration of a client.

use std::collections::BTreeMap;
use std::time::Duration;

use egp_driver::DriverConfig;
use egp_gate::Limits;
use egp_wire::keys::NameError;

/// Configuration of a [`crate::VehicleClient`].
#[derive(Clone, Debug)]
pub struct VehicleConfig {
    /// Name, budget, actuator limits and gate of the vehicle.
    pub driver: DriverConfig,
    /// Routers or replicas to connect to, as `tcp/host:7447`.
    pub connect: Vec<String>,
    /// How long to wait for a replica when connecting. Default 10 s.
    pub patience: Duration,
    /// Single zenoh settings, key path to JSON5 value, for TLS and the like.
    pub zenoh: BTreeMap<String, String>,
}

impl VehicleConfig {
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
            connect: connect.iter().map(ToString::to_string).collect(),
            patience: Duration::from_secs(10),
            zenoh: BTreeMap::new(),
        })
    }
}
