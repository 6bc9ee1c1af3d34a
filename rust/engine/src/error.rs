//! Why an engine cannot be made.

use std::io;

use egp_core::{LibraryError, MOST_FORCE, ParameterError, step::SetupError};
use thiserror::Error;

/// Why an engine cannot be made.
#[derive(Debug, Error)]
pub enum EngineError {
    /// The library file cannot be read.
    #[error(
        "cannot read the library {path}: {source}; give the path of a library, which `egp train` makes"
    )]
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
    /// The library of the file cannot be served with the settings.
    #[error("{path} cannot be served with these settings: {source}")]
    Unfit {
        /// The file.
        path: String,
        /// Why it cannot be served.
        source: Box<EngineError>,
    },
    /// The settings are not valid.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The library's vehicle with the settings' mass and front axle is outside the ranges of a vehicle.
    #[error("with the mass and the front axle of the settings in place of the library's own, {0}")]
    Vehicle(#[from] ParameterError),
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
        /// The limit of [`egp_wire::limits`].
        limit: usize,
    },
    /// Larger forces than a message can carry.
    #[error(
        "the largest force of the vehicle to control is {force} N (mass {mass} kg, acceleration {acceleration} m/s²), the wire \
         carries at most {MOST_FORCE} N; check the units of mass and limits in the settings or in the library"
    )]
    Force {
        /// The force, N.
        force: f64,
        /// The mass, kg.
        mass: f64,
        /// The larger one of the strongest drive and braking, m/s².
        acceleration: f64,
    },
}
