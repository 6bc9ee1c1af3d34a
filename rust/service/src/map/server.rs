//! A running map service: start and stop.

use std::collections::BTreeSet;
use std::fs::File;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use egp_session::NetworkError;
use egp_wire::{road_keys, survive_file_size_limit};
use signal_hook::iterator::Signals;
use thiserror::Error;

use super::config::MapConfig;
use super::encoding::with_checksum;
use super::file::load;
use super::file_error::RoadFileError;
use super::folder_lock::lock;
use super::intake::Intake;
use super::keeper::{Ended, Keeper, clocks};
use super::pages::MapPages;
use super::store::{Road, Store};
use super::writer::{Content, Writer, remove_unfinished, write};
use crate::certificates;
use crate::config_error::ConfigError;
use crate::configuration::{Configured, MAP, configuration, rehearse};
use crate::descriptors::allow_all;
use crate::heap;
use crate::http::{HttpEndpoint, HttpListener};
use crate::links::{Links, Watch, watch};
use crate::logging::{FlushAtEnd, init_logging, log_filter};
use crate::network::{Network, PATIENCE, Received};
use crate::serve::ServiceSignals;
use crate::start_error::StartError;

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
    /// The address for HTTP cannot be listened on, or its thread cannot be started.
    #[error(transparent)]
    Http(#[from] StartError),
    /// An operation of zenoh that failed.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// Roads could not be written at the end.
    #[error(
        "{0} of the map's roads could not be written, and what changed since their last writing is lost; the log has the reasons"
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
    watch: Option<Watch>,
    http: Option<HttpEndpoint>,
    /// Keeps other services from the folder.
    _lock: Option<File>,
}

impl MapServer {
    /// Reads the roads' files and starts answering.
    ///
    /// # Errors
    /// [`MapError`]; nothing keeps running then.
    pub fn start(config: &MapConfig) -> Result<Self, MapError> {
        Self::start_unless(config, &mut || false, Box::new(|| {}))
    }

    /// As [`MapServer::start`], but ends with an error if `stopped` returns true while it waits for a router. `ended` is called
    /// when the thread that keeps the map has ended, also by a panic.
    fn start_unless(
        config: &MapConfig,
        stopped: &mut dyn FnMut() -> bool,
        ended: Ended,
    ) -> Result<Self, MapError> {
        config.validate()?;
        let started = Instant::now();
        let (store, lock) = stored(config, started)?;
        let (zenoh, end) = zenoh_settings(config)?;
        let mut intake = Intake::new();
        let links = Links::of(&zenoh, intake.metrics.registry())?;
        if let Some(end) = end {
            certificates::show(end, intake.metrics.registry());
        }
        let intake = Arc::new(intake);
        let serving = Arc::new(AtomicBool::new(false));
        let http = config.http.map(HttpListener::bind).transpose()?;
        let pages = Arc::new(MapPages {
            intake: intake.clone(),
            links: links.clone(),
            serving: serving.clone(),
        });
        let http = http.map(|listener| listener.answer(pages)).transpose()?;
        let network = Network::open(zenoh, PATIENCE, stopped)?;
        links.note(network.surroundings().links());
        let watch = watch(links, network.surroundings())?;
        let (contributions, roads) = (store.contributions(), store.roads());
        let putter = network.putter();
        let writer = config.folder.clone().map(|folder| {
            let woken = intake.clone();
            let write = move |road: &Road, content: Content| {
                write(&folder, road, content.map(with_checksum))
            };
            Writer::start(write, move || woken.waiting.wake())
        });
        let keeper = Keeper {
            store,
            intake: intake.clone(),
            put: Box::new(move |key, payload| putter.put(key, payload)),
            writer: writer.transpose()?,
            round: BTreeSet::new(),
            started,
            publish: Duration::from_millis(config.publish_ms),
            save: Duration::from_millis(config.save_ms),
            ended,
        };
        let thread = thread::Builder::new().name("egp-map".to_owned());
        let keeper = Some(thread.spawn(move || keeper.run())?);
        let mut server = Self {
            network,
            intake: intake.clone(),
            keeper,
            watch: Some(watch),
            http,
            _lock: lock,
        };
        let declared = server
            .network
            .declare(road_keys::ALL, move |query| intake.take(query));
        declared?;
        serving.store(true, Ordering::Relaxed);
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
        // The keeper ends once it has answered the queries that wait.
        self.intake.waiting.close();
        let unsaved = keeper.join();
        drop((self.http.take(), self.watch.take()));
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

/// What the roads' files hold, and the lock that keeps other services from their folder, if there is one.
fn stored(config: &MapConfig, started: Instant) -> Result<(Store, Option<File>), MapError> {
    let mut store = Store::new(config.merge(), config.limits());
    let lock = config.folder.as_deref().map(lock).transpose()?;
    if let Some(folder) = &config.folder {
        remove_unfinished(folder)?;
        load(folder, &mut store, clocks(started))?;
    }
    Ok((store, lock))
}

/// The settings of zenoh, and when the first of their certificates expires, s since 1970, if they have some.
fn zenoh_settings(config: &MapConfig) -> Result<Configured, NetworkError> {
    let mut zenoh = config.zenoh.clone();
    if config.zenoh_file.is_none() {
        let (key, value) = LISTEN;
        zenoh
            .entry(key.to_owned())
            .or_insert_with(|| value.to_owned());
    }
    configuration(config.zenoh_file.as_deref(), &zenoh, Some(MAP))
}

/// Checks what a map service needs to start, except its folder, which a running service may have locked: the log filter, all
/// values, the host for HTTP, and a zenoh session, which listens on free ports and connects to nothing. Returns a warning
/// about the certificate that expires first, if it is time to renew it.
///
/// # Errors
/// [`MapError`] as [`serve_map`] would report it.
pub fn check_map(config: &MapConfig) -> Result<Option<String>, MapError> {
    log_filter(&config.log).map_err(MapError::Logging)?;
    config.validate()?;
    config.http.map(HttpListener::check).transpose()?;
    let (zenoh, end) = zenoh_settings(config)?;
    rehearse(zenoh, config.http)?;
    Ok(end.and_then(|end| certificates::warning(end, certificates::now())))
}

/// Keeps a map until SIGTERM, SIGINT or SIGHUP; one that the process ignores, as SIGHUP under `nohup`, has no effect.
///
/// # Errors
/// [`MapError`] if the service does not start, something is not written at the end, or the thread that keeps the map panicked,
/// which ends the service.
pub fn serve_map(config: &MapConfig, signals: ServiceSignals) -> Result<(), MapError> {
    let ServiceSignals(mut signals) = signals;
    heap::share();
    let _flush = FlushAtEnd;
    init_logging(&config.log, config.log_json).map_err(MapError::Logging)?;
    allow_all();
    survive_file_size_limit()?;
    let (mut ended, closing) = (false, closing(&signals));
    let mut stopped = || {
        ended |= signals.pending().next().is_some();
        ended
    };
    let server = match MapServer::start_unless(config, &mut stopped, closing) {
        Err(_) if ended => return Ok(()),
        Err(error) => {
            if config.log_json {
                // The caller prints the error as plain text, which a program that collects JSON lines does not read.
                tracing::error!(%error, "not started");
            }
            return Err(error);
        }
        Ok(server) => server,
    };
    wait(&mut signals);
    server.stop()
}

/// A function that ends the wait for signals.
fn closing(signals: &Signals) -> Ended {
    let handle = signals.handle();
    Box::new(move || handle.close())
}

/// Waits for a signal, or until [`closing`] ends the wait.
fn wait(signals: &mut Signals) {
    if let Some(signal) = signals.forever().next() {
        tracing::info!(signal, "signal received");
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use egp_testing::ports::free_endpoint;
    use signal_hook::consts::SIGUSR1;

    use super::*;

    #[test]
    fn the_wait_for_signals_ends_with_the_keeper() {
        let mut config = MapConfig::default();
        let (key, listen) = ("listen/endpoints", format!("[\"{}\"]", free_endpoint()));
        config.zenoh.insert(key.to_owned(), listen);
        let mut signals = Signals::new([SIGUSR1]).unwrap();
        let ended = closing(&signals);
        let server = MapServer::start_unless(&config, &mut || false, ended).unwrap();
        server.intake.waiting.close();
        let (told, end) = std::sync::mpsc::channel();
        thread::spawn(move || {
            wait(&mut signals);
            told.send(())
        });
        end.recv_timeout(Duration::from_secs(60)).unwrap();
        server.stop().unwrap();
    }
}
