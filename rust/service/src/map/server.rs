//! A running map service: start and stop.

use std::io;
use std::sync::Arc;
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use egp_wire::road_keys;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use thiserror::Error;

use super::config::MapConfig;
use super::file::{RoadFileError, load};
use super::intake::Intake;
use super::keeper::{Keeper, clocks};
use super::store::Store;
use crate::config::ConfigError;
use crate::logging::init_logging;
use crate::network::{Network, NetworkError, PATIENCE, configuration};

/// Queries of all vehicles that may wait.
const WAITING: usize = 1024;
/// Where the service listens by default; a service of control steps on the same machine has the port before this one.
const LISTEN: (&str, &str) = ("listen/endpoints", r#"["tcp/127.0.0.1:7448"]"#);

/// Why a map service did not start.
#[derive(Debug, Error)]
pub enum MapStartError {
    /// The configuration is out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A road's file cannot be used.
    #[error(transparent)]
    File(#[from] RoadFileError),
    /// The log filter is not valid.
    #[error("{0}")]
    Logging(String),
    /// The system could not start a thread or catch signals.
    #[error("cannot start a thread or catch signals: {0}")]
    System(#[from] io::Error),
    /// An operation of zenoh that failed.
    #[error(transparent)]
    Network(#[from] NetworkError),
}

/// A map service that answers queries until it is stopped or dropped.
pub struct MapServer {
    network: Network,
    keeper: Option<JoinHandle<()>>,
}

impl MapServer {
    /// Reads the roads' files and starts answering.
    ///
    /// # Errors
    /// [`MapStartError`]; nothing keeps running then.
    pub fn start(config: &MapConfig) -> Result<Self, MapStartError> {
        Self::start_unless(config, &mut || false)
    }

    /// As [`MapServer::start`], but ends with an error if `stopped` returns true while it waits for a router.
    fn start_unless(
        config: &MapConfig,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Result<Self, MapStartError> {
        config.validate()?;
        let started = Instant::now();
        let mut store = Store::new(config.merge(), config.limits());
        if let Some(folder) = &config.folder {
            load(folder, &mut store, clocks(started))?;
        }
        let mut zenoh = config.zenoh.clone();
        if config.zenoh_file.is_none() {
            let (key, value) = LISTEN;
            zenoh
                .entry(key.to_owned())
                .or_insert_with(|| value.to_owned());
        }
        let zenoh = configuration(config.zenoh_file.as_deref(), &zenoh)?;
        let mut network = Network::open_patiently(zenoh, PATIENCE, stopped)?;
        let intake = Arc::new(Intake::new());
        let (contributions, roads) = (store.contributions(), store.roads());
        let keeper = Keeper {
            store,
            intake: intake.clone(),
            network: network.putter(),
            folder: config.folder.clone(),
            started,
            publish: Duration::from_millis(config.publish_ms),
            save: Duration::from_millis(config.save_ms),
        };
        let (sender, jobs) = mpsc::sync_channel(WAITING);
        let thread = thread::Builder::new().name("egp-map".to_owned());
        let keeper = thread.spawn(move || keeper.run(&jobs))?;
        network.declare(road_keys::ALL, move |query| intake.take(query, &sender))?;
        tracing::info!(roads, contributions, "keeping a map");
        Ok(Self {
            network,
            keeper: Some(keeper),
        })
    }

    /// Answers the queries that wait, writes what is not yet written, and closes.
    pub fn stop(mut self) {
        self.end();
    }

    fn end(&mut self) {
        let Some(keeper) = self.keeper.take() else {
            return;
        };
        self.network.undeclare(); // the sender goes with the intake, which ends the keeper
        if keeper.join().is_err() {
            tracing::error!("the keeper's thread ended by a panic");
        }
        self.network.close();
        tracing::info!("map closed");
    }
}

impl Drop for MapServer {
    fn drop(&mut self) {
        self.end();
    }
}

/// Keeps a map until SIGTERM or SIGINT.
///
/// # Errors
/// [`MapStartError`] if the service does not start.
pub fn serve_map(config: &MapConfig) -> Result<(), MapStartError> {
    init_logging(&config.log, config.log_json).map_err(MapStartError::Logging)?;
    // Signals are registered before the start, so that an early one is not lost.
    let mut signals = Signals::new([SIGTERM, SIGINT])?;
    let mut ended = false;
    let mut stopped = || {
        ended |= signals.pending().next().is_some();
        ended
    };
    let server = match MapServer::start_unless(config, &mut stopped) {
        Err(_) if ended => return Ok(()),
        started => started?,
    };
    if let Some(signal) = signals.forever().next() {
        tracing::info!(signal, "signal received");
    }
    server.stop();
    Ok(())
}
