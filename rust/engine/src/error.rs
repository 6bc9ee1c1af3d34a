//! Why an engine could not be made.

use std::io;

use egp_core::{LibraryError, step::SetupError};
use thiserror::Error;

/// Why an engine could not be made.
#[derive(Debug, Error)]
pub enum EngineError {
    /// The library file cannot be read.
    #[error("cannot read the library {path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// What the system said.
        source: io::Error,
    },
    /// The library file was refused.
    #[error("{path} is refused: {source}")]
    Library {
        /// The file.
        path: String,
        /// Why.
        source: LibraryError,
    },
    /// The settings were refused.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The system gave no threads for parts of steps.
    #[error("cannot start threads for parts of steps: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// More than a message can carry.
    #[error("{what} is {actual}, the wire carries at most {limit}")]
    Limit {
        /// Which quantity.
        what: &'static str,
        /// Its value.
        actual: usize,
        /// The limit of [`egp_wire::Limits`].
        limit: usize,
    },
}
