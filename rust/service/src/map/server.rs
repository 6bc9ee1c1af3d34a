//! A running map service: start and stop.

use std::collections::BTreeSet;
use std::fs::File;
use std::io;
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use egp_session::NetworkError;
use egp_wire::road_keys;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use thiserror::Error;

use super::config::MapConfig;
use super::file::load;
use super::file_error::RoadFileError;
use super::folder_lock::lock;
use super::intake::Intake;
use super::keeper::{Keeper, clocks};
use super::store::{Road, Store};
use super::writer::{Content, Writer, remove_unfinished, write};
use crate::certificates;
use crate::config::ConfigError;
use crate::descriptors::allow_all;
use crate::logging::init_logging;
use crate::network::{Network, PATIENCE, Received, configuration};

/// Where the service listens by default; a service of control steps on the same machine has the port before this one.
const LISTEN: (&str, &str) = ("listen/endpoints", r#"["tcp/127.0.0.1:7448"]"#);

/// Why a map service did not start, or lost something at its end.
#[derive(Debug, Error)]
pub enum MapError {
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
    /// Roads could not be written at the end.
    #[error(
        "{0} roads of the map were not written, and what changed since their last writing is lost; the log has the reasons"
    )]
    Unsaved(usize),
    /// The thread that keeps the map panicked.
    #[error(
        "the thread that keeps the map ended by a panic, and what changed since the last writing is lost; the log has the \
         reason"
    )]
    Panic,
}

/// A map service that answers queries until it is stopped or dropped.
pub struct MapServer {
    network: Network,
    intake: Arc<Intake<Received>>,
    keeper: Option<JoinHandle<usize>>,
    /// Keeps other services from the folder.
    _lock: Option<File>,
}

impl MapServer {
    /// Reads the roads' files and starts answering.
    ///
    /// # Errors
    /// [`MapError`]; nothing keeps running then.
    pub fn start(config: &MapConfig) -> Result<Self, MapError> {
        Self::start_unless(config, &mut || false)
    }

    /// As [`MapServer::start`], but ends with an error if `stopped` returns true while it waits for a router.
    fn start_unless(
        config: &MapConfig,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Result<Self, MapError> {
        config.validate()?;
        let started = Instant::now();
        let mut store = Store::new(config.merge(), config.limits());
        let lock = config.folder.as_deref().map(lock).transpose()?;
        if let Some(folder) = &config.folder {
            remove_unfinished(folder)?;
            load(folder, &mut store, clocks(started))?;
        }
        let mut zenoh = config.zenoh.clone();
        if config.zenoh_file.is_none() {
            let (key, value) = LISTEN;
            zenoh
                .entry(key.to_owned())
                .or_insert_with(|| value.to_owned());
        }
        let (zenoh, end) = configuration(config.zenoh_file.as_deref(), &zenoh)?;
        let network = Network::open(zenoh, PATIENCE, stopped)?;
        let mut intake = Intake::new();
        if let Some(end) = end {
            certificates::show(end, intake.metrics.registry());
        }
        let intake = Arc::new(intake);
        let (contributions, roads) = (store.contributions(), store.roads());
        let putter = network.putter();
        let writer = config.folder.clone().map(|folder| {
            let woken = intake.clone();
            let write = move |road: &Road, content: Content| write(&folder, road, content);
            Writer::start(write, move || woken.waiting.wake())
        });
        let keeper = Keeper {
            store,
            intake: intake.clone(),
            put: Box::new(move |key, payload| putter.put(key, payload)),
            writer: writer.transpose()?,
            due: BTreeSet::new(),
            started,
            publish: Duration::from_millis(config.publish_ms),
            save: Duration::from_millis(config.save_ms),
        };
        let thread = thread::Builder::new().name("egp-map".to_owned());
        let keeper = Some(thread.spawn(move || keeper.run())?);
        let mut server = Self {
            network,
            intake: intake.clone(),
            keeper,
            _lock: lock,
        };
        let declared = server
            .network
            .declare(road_keys::ALL, move |query| intake.take(query));
        declared?;
        tracing::info!(roads, contributions, "keeping a map");
        Ok(server)
    }

    /// Answers the queries that wait, writes what is not yet written, and closes.
    ///
    /// # Errors
    /// [`MapError::Unsaved`] or [`MapError::Panic`] if something was not written.
    pub fn stop(mut self) -> Result<(), MapError> {
        self.end()
    }

    fn end(&mut self) -> Result<(), MapError> {
        let Some(keeper) = self.keeper.take() else {
            return Ok(());
        };
        self.network.undeclare();
        self.intake.waiting.close(); // which ends the keeper once it has answered what waits
        let unsaved = keeper.join();
        self.network.close();
        tracing::info!("map closed");
        match unsaved {
            Ok(0) => Ok(()),
            Ok(roads) => Err(MapError::Unsaved(roads)),
            Err(_) => Err(MapError::Panic),
        }
    }
}

impl Drop for MapServer {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            tracing::error!(%error, "map closed");
        }
    }
}

/// Keeps a map until SIGTERM, SIGINT or SIGHUP.
///
/// # Errors
/// [`MapError`] if the service does not start, or if something is not written at the end.
pub fn serve_map(config: &MapConfig) -> Result<(), MapError> {
    init_logging(&config.log, config.log_json).map_err(MapError::Logging)?;
    allow_all();
    // Signals are registered before the start, so that an early one is not lost.
    let mut signals = Signals::new([SIGTERM, SIGINT, SIGHUP])?;
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
    server.stop()
}
