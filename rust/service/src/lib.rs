//! The control step as a network service.
//!
//! ```text
//! zenoh query ─ intake ─► queue ─► worker ─► engine ─► reply
//!               header     one slot per vehicle,      decode, step, encode
//!               admission  earliest deadline first
//! ```
//!
//! An [`egp_engine::Engine`] turns request bytes into reply bytes, here as in a vehicle's own process. [`Server`] makes
//! it available on the network; [`serve`] runs one until a signal.

mod background;
mod certificates;
mod config;
mod config_error;
mod configuration;
mod descriptors;
mod events;
mod fetch;
mod fetch_error;
mod guard;
mod handler;
mod heap;
mod http;
mod intake;
mod libraries;
mod library_table;
mod links;
mod log_writer;
mod logging;
pub mod map;
mod metrics;
mod network;
mod offer;
mod pages;
mod query;
mod queue;
mod reloader;
mod replica;
mod reporter;
mod serve;
mod served;
mod server;
mod signature;
mod standing;
mod start_error;
mod sync;
mod traces;
mod worker;
mod zenoh_settings;

pub use config::ServiceConfig;
pub use config_error::ConfigError;
pub use configuration::{check_certificates, is_encrypted};
pub use egp_session::NetworkError;
pub use fetch::{Fetched, Wanted};
pub use fetch_error::{FetchError, FetchFailure};
pub use handler::{Handler, LibraryContent};
pub use libraries::{Libraries, ReloadError};
pub use library_table::{LibraryTable, Reloaded, TableFull, TableWorkspace};
pub use logging::init_logging;
pub use query::Query;
pub use replica::Replica;
pub use serve::{Checked, ServeError, ServiceSignals, check, serve};
pub use server::Server;
pub use signature::SignatureError;
pub use start_error::StartError;
pub use worker::catch_step;
