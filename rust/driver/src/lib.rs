//! Everything that a vehicle's side decides about control steps: which replica to ask, how long to wait, which replies
//! to use, what to carry to the next step, and what reaches the actuators. [`FleetExchange`] decides what it tells a fleet's
//! map, and what it asks it.
//!
//! [`Driver`] is a state machine without clock, network or threads. A transport reports each event with its time, and
//! carries out the [`Action`]s that the driver returns. The onboard client does this over zenoh, the in-process
//! controllers with an engine beside them; the decisions are the same.
//!
//! ```
//! use std::time::Duration;
//! use egp_driver::{Action, Driver, DriverConfig, Measurement};
//! # use egp_gate::{Limits, Mode};
//! # let vehicle = egp_parameters::VehicleParameters::FORD_ESCORT;
//! # let limits = Limits::of(&vehicle);
//! # let served = egp_wire::Ready {
//! #     ready: true, library: [7; 32], others: vec![], dt: 0.02, horizon: 4, history: 3, members: vec!["dry".into()],
//! #     envelope: [[0.0, -5.0, -2.0, -0.6, -9e3, -0.4], [30.0, 5.0, 2.0, 0.6, 9e3, 0.4]],
//! #     vehicle: Some(vehicle),
//! #     sealed: false,
//! # };
//! let mut driver = Driver::new(DriverConfig::new("depot", "car-7", limits)?, served)?;
//! driver.replica_appeared("garage-1".parse()?);
//! driver.replica_fits(&"garage-1".parse()?); // it gave the description `served`
//!
//! let x = [0.0, 0.0, 12.0, 0.0, 0.0, 0.0, 0.0];
//! let reference = (0..=4).map(|t| [0.24 * f64::from(t), 0.0, 12.0, 0.0]).collect();
//! let (now, deadline) = (Duration::from_millis(20), Duration::from_millis(36));
//! driver.tick(now, deadline, Measurement { x, reference, ..Measurement::default() })?;
//! let Some(Action::Ask(query)) = driver.next_action() else { unreachable!() };
//! assert_eq!(query.key, "egp/v1/r/garage-1/depot/car-7/step");
//!
//! driver.wake(deadline); // no answer came
//! let Some(Action::Command(step)) = driver.next_action() else { unreachable!() };
//! assert_eq!(step.command.mode, Mode::Waiting); // it brakes until the first plan comes
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod action;
mod carry;
mod config;
mod discovery;
mod driver;
mod fleet;
mod in_process;
mod measurement;
mod rank;
mod replicas;
mod reply;
mod situation;
mod step;

pub use action::{Action, Query, QueryId};
pub use carry::Carry;
pub use config::{DriverConfig, DriverError, RunKey};
pub use discovery::{Discovery, DiscoveryError, Question, Unusable};
pub use driver::{Driver, Time};
pub use fleet::{
    FleetAction, FleetExchange, FleetNotice, FleetSettings, FleetSettingsError, MapQuery, Purpose,
};
pub use in_process::{Answer, InProcessDriver};
pub use measurement::{InvalidArgument, Measurement};
pub use situation::{Lost, Outside, Situation};
pub use step::{Late, Outcome, Step};
