//! What a vehicle needs to know before it drives.

use std::collections::BTreeMap;
use std::time::Duration;

use egp_gate::Limits;
use egp_wire::keys::{Name, NameError};

/// Configuration of a [`crate::VehicleClient`].
#[derive(Clone, Debug)]
pub struct VehicleConfig {
    /// Fleet the vehicle belongs to.
    pub fleet: Name,
    /// The vehicle's name in its fleet.
    pub vehicle: Name,
    /// Routers or replicas to connect to, as `tcp/host:7447`.
    pub connect: Vec<String>,
    /// Part of the control period that an answer may take, in (0, 1]. Default 0.8.
    pub budget: f64,
    /// How long to wait for a replica when connecting. Default 10 s.
    pub patience: Duration,
    /// Limits of the actuators.
    pub limits: Limits,
    /// Control periods that the rest of a plan may bridge. Default 25, half a second at 50 Hz.
    pub max_tail_ticks: u64,
    /// How hard to brake when it has run out, m/s². Default 3.
    pub stop_deceleration: f64,
    /// Single zenoh settings, key path to JSON5 value, for TLS and the like.
    pub zenoh: BTreeMap<String, String>,
}

impl VehicleConfig {
    /// Defaults for a vehicle of this name with these actuators that connects to these endpoints.
    ///
    /// # Errors
    /// [`NameError`] for a fleet or vehicle that is no name.
    pub fn new(
        fleet: &str,
        vehicle: &str,
        connect: &[&str],
        limits: Limits,
    ) -> Result<Self, NameError> {
        Ok(Self {
            fleet: fleet.parse()?,
            vehicle: vehicle.parse()?,
            connect: connect.iter().map(ToString::to_string).collect(),
            budget: 0.8,
            patience: Duration::from_secs(10),
            limits,
            max_tail_ticks: 25,
            stop_deceleration: 3.0,
            zenoh: BTreeMap::new(),
        })
    }
}
