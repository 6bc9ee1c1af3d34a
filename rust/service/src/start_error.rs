//! Why a service did not start.

use std::net::SocketAddr;

use egp_session::NetworkError;
use egp_trace::TraceError;
use egp_wire::{KeyFileError, WireError};
use thiserror::Error;

use crate::config_error::ConfigError;
use crate::fetch_error::FetchError;
use crate::libraries::ReloadError;

/// Why a service did not start.
#[derive(Debug, Error)]
pub enum StartError {
    /// The configuration is out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A library or the settings cannot be used.
    #[error(transparent)]
    Library(#[from] ReloadError),
    /// The library was not fetched from another replica.
    #[error(transparent)]
    Fetch(#[from] FetchError),
    /// A worker could not be set up.
    #[error("cannot set up a worker: {0}")]
    Worker(#[from] WireError),
    /// The system could not start a thread.
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// The address for HTTP cannot be listened on.
    #[error("cannot listen for HTTP on {address}: {reason}; choose another address for `http`")]
    Http {
        /// The address.
        address: SocketAddr,
        /// The error of the system.
        reason: String,
    },
    /// The keys of the vehicles cannot be used.
    #[error(transparent)]
    Keys(#[from] KeyFileError),
    /// The file of traces cannot be written.
    #[error(transparent)]
    Traces(#[from] TraceError),
    /// An operation of zenoh that failed.
    #[error(transparent)]
    Network(#[from] NetworkError),
}
