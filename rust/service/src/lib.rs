//! The control step as a network service.
//!
//! ```text
//! zenoh query ─ intake ─► queue ─► worker ─► engine ─► reply
//!               header     one slot a vehicle,        decode, step, encode
//!               admission  earliest deadline first
//! ```
//!
//! [`Engine`] turns request bytes into reply bytes and is what the in-process controller uses too, so both
//! give the same bits. [`Server`] puts it on the network; [`serve`] runs one until a signal.

mod config;
mod cores;
mod engine;
mod intake;
mod logging;
mod metrics;
mod network;
mod queue;
mod serve;
mod server;
mod stepper;
mod worker;

pub use config::{ConfigError, ServiceConfig};
pub use engine::{Engine, EngineError, EngineWorkspace};
pub use logging::init_logging;
pub use network::NetworkError;
pub use serve::{ServeError, serve};
pub use server::{Server, StartError};
pub use stepper::Stepper;
