//! Why an engine cannot be made.

use std::io;

use egp_core::{LibraryError, step::SetupError};
use thiserror::Error;

/// Why an engine cannot be made.
#[derive(Debug, Error)]
pub enum EngineError {
    /// The library file cannot be read.
    #[error("cannot read the library {path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// The error of the system.
        source: io::Error,
    },
    /// The library file failed a check.
    #[error("{path} cannot be used: {source}")]
    Library {
        /// The file.
        path: String,
        /// The check that failed.
        source: LibraryError,
    },
    /// The settings are not valid.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The system could not start threads for parts of steps.
    #[error("cannot start threads for parts of steps: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// More than a message can carry.
    #[error("{what} is {actual}, the wire carries at most {limit}")]
    Limit {
        /// Which quantity.
        what: &'static str,
        /// Its value.
        actual: usize,
        /// The limit of [`egp_wire::MessageLimits`].
        limit: usize,
    },
}
