//! The onboard client, which carries out a driver's decisions over zenoh. It holds no solver and no library.
//!
//! ```no_run
//! # fn measured() -> ([f64; 7], Vec<[f64; 4]>) { ([0.0; 7], vec![]) }
//! # fn actuate(_: [f64; 2]) {}
//! use egp_vehicle::{GateLimits, VehicleClient, VehicleConfig, VehicleParameters};
//!
//! let limits = GateLimits::of(&VehicleParameters::FORD_ESCORT);
//! let config = VehicleConfig::new("depot", "car-7", limits, &["tcp/control.example:7447"])?;
//! let mut vehicle = VehicleClient::connect(&config)?;
//! loop { // once every `vehicle.dt()` seconds
//!     let (x, reference) = measured();
//!     let step = vehicle.step(x, &reference, &[])?;
//!     actuate(step.command.u);
//!     # break;
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`FleetMap`] exchanges what the vehicle measured about a road's friction with the other vehicles of its fleet.
//!
//! A program calls [`set_network_threads`] first, so that a replica that falls silent does not delay the answers of others, and
//! [`survive_file_size_limit`] if it writes traces.

mod client;
mod config;
mod fleet_map;
mod network;
mod reach;
mod status;
mod traces;

pub use client::{ClientError, VehicleClient};
pub use config::{VehicleConfig, VehicleKeyError};
pub use egp_driver::{DriverConfig, Late, Lost, Measurement, Outcome, Situation, Step, Unusable};
pub use egp_driver::{FleetNotice, FleetSettings, FleetSettingsError};
pub use egp_gate::{Command, Limits as GateLimits, Mode};
pub use egp_map::RoadBelief;
pub use egp_parameters::VehicleParameters;
pub use egp_session::NetworkError;
pub use egp_wire::{
    ask_for_tls, print_line, print_notice, set_network_threads, survive_file_size_limit,
};
pub use fleet_map::{FleetMap, FleetMapConfig, FleetMapError};
pub use network::{ask, open_session};
pub use traces::{StepTraces, StepTracesError};
