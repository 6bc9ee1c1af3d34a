//! A service as a whole process: `egp-server` and `egp serve`.

use egp_trace::TraceFile;
use egp_wire::{Ready, not_ignored, survive_file_size_limit};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use thiserror::Error;

use crate::certificates::{now, warning};
use crate::config::ServiceConfig;
use crate::configuration::{SERVICE, configuration, rehearse};
use crate::descriptors::allow_all;
use crate::guard::{Guard, exposed};
use crate::handler::Handler as _;
use crate::heap;
use crate::http::HttpListener;
use crate::libraries::Libraries;
use crate::logging::{FlushAtEnd, init_logging, log_filter};
use crate::server::{Server, wanted};
use crate::start_error::StartError;

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

/// What [`check`] found.
#[derive(Debug)]
pub struct Checked {
    /// What the service would serve.
    pub served: Ready,
    /// A warning about the certificate that expires first, if it is time to renew it, and one about a file of secret keys that
    /// every user of the machine may use.
    pub warnings: Vec<String>,
}

/// Checks all that a service needs to start, and returns what it would serve: the log filter, library, settings, the file
/// of traces, the host for HTTP, and a zenoh session, which listens on free ports and connects to nothing.
///
/// # Errors
/// [`ServeError`] as [`serve`] would report it.
pub fn check(config: &ServiceConfig) -> Result<Checked, ServeError> {
    log_filter(&config.log).map_err(ServeError::Logging)?;
    config.validate().map_err(StartError::from)?;
    if let Some(wanted) = wanted(config) {
        wanted.check().map_err(StartError::from)?;
    }
    let libraries = Libraries::load(config).map_err(StartError::from)?;
    let keys = config.vehicle_keys.as_deref().map(Guard::load);
    keys.transpose().map_err(StartError::from)?;
    let traces = config.traces.as_deref().map(TraceFile::check);
    traces.transpose().map_err(StartError::from)?;
    config.http.map(HttpListener::check).transpose()?;
    let (zenoh, end) = configuration(config.zenoh_file.as_deref(), &config.zenoh, Some(SERVICE))
        .map_err(StartError::from)?;
    rehearse(zenoh, config.http).map_err(StartError::from)?;
    Ok(Checked {
        served: libraries.describe(),
        warnings: (end.and_then(|end| warning(end, now())).into_iter())
            .chain(config.vehicle_keys.as_deref().and_then(exposed))
            .collect(),
    })
}

/// The signals that a service waits for. One that comes after they were registered is not lost.
pub struct ServiceSignals(pub(crate) Signals);

impl ServiceSignals {
    /// Registers SIGTERM and SIGINT, unless this process inherited them as ignored, and SIGHUP.
    ///
    /// # Errors
    /// [`ServeError::Signals`].
    pub fn register() -> Result<Self, ServeError> {
        let mut caught = not_ignored(&[SIGTERM, SIGINT]);
        caught.push(SIGHUP); // also under `nohup`, because it does not end this program
        Signals::new(caught).map(Self).map_err(ServeError::Signals)
    }

    /// Registers SIGTERM, SIGINT and SIGHUP, which all end a map service, unless this process inherited them as ignored.
    ///
    /// # Errors
    /// [`ServeError::Signals`].
    pub fn register_for_map() -> Result<Self, ServeError> {
        let caught = not_ignored(&[SIGTERM, SIGINT, SIGHUP]);
        Signals::new(caught).map(Self).map_err(ServeError::Signals)
    }
}

/// Fetches the library first if the configuration states one by its hash. Serves until SIGTERM or SIGINT, then drains.
/// SIGHUP loads the library file again.
///
/// # Errors
/// [`ServeError`] if the service does not start.
pub fn serve(config: &ServiceConfig, signals: ServiceSignals) -> Result<(), ServeError> {
    let ServiceSignals(mut signals) = signals;
    heap::share();
    let _flush = FlushAtEnd;
    init_logging(&config.log, config.log_json).map_err(ServeError::Logging)?;
    allow_all();
    survive_file_size_limit().map_err(ServeError::Signals)?;
    let (mut ended, mut reload) = (false, false);
    let mut stopped = || {
        for signal in signals.pending() {
            match signal {
                SIGHUP => reload = true,
                _ => ended = true,
            }
        }
        ended
    };
    let server = match Server::start_unless(config, &mut stopped) {
        Err(_) if ended => {
            tracing::info!("ended by a signal before the service had started");
            return Ok(());
        }
        Err(error) => {
            if config.log_json {
                // The caller prints the error as plain text, which a program that collects JSON lines does not read.
                tracing::error!(%error, "not started");
            }
            return Err(error.into());
        }
        Ok(server) => server,
    };
    // A SIGHUP that came during the start, perhaps after the library had been loaded, has its effect now.
    let early = reload.then_some(SIGHUP);
    for signal in early.into_iter().chain(signals.forever()) {
        tracing::info!(signal, "signal received");
        if signal != SIGHUP {
            break;
        }
        if let Err(error) = server.reload() {
            tracing::error!(%error, "library not loaded");
        }
    }
    server.drain();
    Ok(())
}
