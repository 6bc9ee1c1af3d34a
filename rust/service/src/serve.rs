//! A service as a whole process: `egp-server` and `egp serve`.

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use thiserror::Error;

use crate::config::ServiceConfig;
use crate::logging::init_logging;
use crate::server::{Server, StartError};

/// Why serving failed.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The log filter is not valid.
    #[error("{0}")]
    Logging(String),
    /// Signals cannot be caught.
    #[error("cannot catch signals: {0}")]
    Signals(std::io::Error),
    /// The service did not start.
    #[error(transparent)]
    Start(#[from] StartError),
}

/// Serves until SIGTERM or SIGINT, then drains.
///
/// # Errors
/// [`ServeError`] if the service does not start.
pub fn serve(config: &ServiceConfig) -> Result<(), ServeError> {
    init_logging(&config.log, config.log_json).map_err(ServeError::Logging)?;
    // Signals are registered before the start, so that an early one is not lost.
    let mut signals = Signals::new([SIGTERM, SIGINT]).map_err(ServeError::Signals)?;
    let server = Server::start(config)?;
    if let Some(signal) = signals.forever().next() {
        tracing::info!(signal, "signal received");
    }
    server.drain();
    Ok(())
}
