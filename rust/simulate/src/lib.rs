//! A deterministic simulation of vehicles, replicas, routers and the network between them.
//!
//! Virtual time, one thread and one seed: the same [`Config`] gives the same trace, byte for byte. The decisions are the
//! product's own: the driver and the gate of each vehicle, intake, queue, workers and libraries of each replica, the engine's
//! control step and the multi-body plant. Only network, clocks and faults are simulated. `docs/simulation.md` describes the
//! faults and the oracles.

mod command;
mod config;
mod delivery;
mod disturbance;
mod event;
mod fault;
mod ledger;
mod library;
mod lifecycle;
mod link;
mod mutant;
mod oracle;
mod period;
mod planted;
mod reloading;
mod replica;
mod router;
mod routing;
mod scene;
mod tampering;
mod trace;
mod vehicle;
mod world;

pub use command::{main, main_with_libraries};
pub use config::{Config, Run};
pub use fault::{Fault, ScheduledFault};
pub use mutant::Mutant;
pub use oracle::{Oracle, Violation};
pub use scene::{Scene, SimulationError};
pub use world::{repeat, simulate};
