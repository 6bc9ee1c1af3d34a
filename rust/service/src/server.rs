//! A running service: start and drain.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use egp_core::library;
use egp_wire::keys;
use prometheus_client::metrics::counter::Counter;

use crate::certificates;
use crate::config::ServiceConfig;
use crate::configuration::{SERVICE, configuration};
use crate::fetch::{Fetched, Wanted};
use crate::fetch_error::FetchError;
use crate::guard::Guard;
use crate::handler::Handler;
use crate::http::{HttpEndpoint, HttpListener};
use crate::intake::Shared;
use crate::libraries::{Libraries, ReloadError};
use crate::library_table::Reloaded;
use crate::links::Links;
use crate::metrics::Metrics;
use crate::network::{Network, PATIENCE, Received};
use crate::offer::{Asked, Offer, offer};
use crate::pages::ServicePages;
use crate::queue::Queue;
use crate::reloader::{Outcome, Reloader, Running, stamp};
use crate::reporter::Reporter;
use crate::standing::Standing;
use crate::start_error::StartError;
use crate::traces::Traces;
use crate::worker::work;

/// A service that answers queries until it is drained or dropped.
pub struct Server {
    shared: Arc<Shared<Received>>,
    network: Network,
    drain: Duration,
    workers: Vec<JoinHandle<()>>,
    offerer: Option<JoinHandle<()>>,
    reporter: Option<(Sender<()>, JoinHandle<()>)>,
    reloader: Option<Running>,
    http: Option<HttpEndpoint>,
    /// The file of the vehicles' keys.
    keys: Option<PathBuf>,
}

impl Server {
    /// Loads the library, which is fetched before if the configuration says so, and starts serving it.
    ///
    /// # Errors
    /// [`StartError`]; nothing keeps running then.
    pub fn start(config: &ServiceConfig) -> Result<Self, StartError> {
        Self::start_unless(config, &mut || false)
    }

    /// As [`Server::start`], but ends with an error if `stopped` returns true while it fetches the library or waits for a
    /// router.
    ///
    /// # Errors
    /// [`StartError`]; nothing keeps running then.
    pub fn start_unless(
        config: &ServiceConfig,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Result<Self, StartError> {
        config.validate()?;
        fetch(config, stopped)?;
        let stamp = stamp(&config.library);
        let libraries = Arc::new(Libraries::load(config)?);
        let mut server = Self::start_shared(config, &libraries, stopped)?;
        let (shared, keys) = (server.shared.clone(), server.keys.clone());
        let reloader = Reloader::new(libraries, config.watch(), stamp)
            .with_keys(move || read_keys(&shared, keys.as_deref()));
        let shared = server.shared.clone();
        server.reloader = Some(reloader.start(move |reloaded| note(&shared.metrics, reloaded))?);
        Ok(server)
    }

    /// Starts serving with any handler; [`Server::start`] uses [`Libraries`].
    ///
    /// # Errors
    /// [`StartError`]; nothing keeps running then.
    pub fn start_with<H: Handler>(config: &ServiceConfig, handler: H) -> Result<Self, StartError> {
        Self::start_shared(config, &Arc::new(handler), &mut || false)
    }

    fn start_shared<H: Handler>(
        config: &ServiceConfig,
        handler: &Arc<H>,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Result<Self, StartError> {
        config.validate()?;
        let (zenoh, end) =
            configuration(config.zenoh_file.as_deref(), &config.zenoh, Some(SERVICE))?;
        let (offering, questions) = Offer::new();
        let mut metrics = Metrics::new(&handler.describe().libraries(), config.workers());
        let twice = metrics.show_name_twice();
        let links = Links::of(&zenoh, metrics.registry())?;
        let shared = share(config, handler, offering, end, metrics)?;
        let replica = shared.replica.clone();
        let serving = Arc::new(AtomicBool::new(false));
        let http = config.http.map(HttpListener::bind).transpose()?;
        let pages = Arc::new(ServicePages {
            shared: shared.clone(),
            links: links.clone(),
            serving: serving.clone(),
        });
        let http = http.map(|listener| listener.answer(pages)).transpose()?;
        let network = Network::open(zenoh, PATIENCE, stopped)?;
        links.note(network.surroundings().links());
        let mut server = Self {
            shared,
            network,
            drain: Duration::from_millis(config.drain_ms),
            workers: Vec::with_capacity(config.workers()),
            offerer: None,
            reporter: None,
            reloader: None,
            http,
            keys: config.vehicle_keys.clone(),
        };
        server.start_workers(handler)?;
        server.start_offerer(handler, questions)?;
        let shared = server.shared.clone();
        server
            .network
            .declare(&keys::replica(&replica), move |query| {
                shared.take(query, Instant::now());
            })?;
        server.start_reporter(Duration::from_millis(config.load_ms), links, twice)?;
        if server.network.announced(&replica) {
            tracing::warn!(
                %replica,
                "another service has this name, and each vehicle reaches either of them; give one of them another --replica"
            );
        }
        // The announcement comes last, because clients ask as soon as they see it.
        server.network.announce(&replica)?;
        serving.store(true, Ordering::Relaxed);
        tracing::info!(
            replica = %replica,
            workers = config.workers(),
            library = library::hex(&handler.describe().library),
            listen = server.network.listen,
            "serving"
        );
        Ok(server)
    }

    /// Reads the keys of the vehicles and loads the library file again on a thread of their own, while requests are answered;
    /// the log and the metrics tell the outcomes. The library that was served before is still served to requests
    /// that state it, and the keys of before hold if the file of the keys cannot be used.
    ///
    /// # Errors
    /// [`ReloadError::NoFile`] if the server was started with a handler of its own, after the keys were read, and
    /// [`ReloadError::Ended`] if the thread has ended.
    pub fn reload(&self) -> Result<(), ReloadError> {
        let Some(running) = &self.reloader else {
            read_keys(&self.shared, self.keys.as_deref());
            return Err(ReloadError::NoFile);
        };
        running.reload()
    }

    /// Withdraws the announcement, serves new requests for a moment longer, finishes those that wait, and closes.
    ///
    /// A client that asks meanwhile gets an answer or an error.
    pub fn drain(mut self) {
        tracing::info!("draining");
        self.shared.draining.store(true, Ordering::Relaxed);
        self.network.withdraw();
        thread::sleep(self.drain);
        self.stop();
        tracing::info!("drained");
    }

    fn start_workers<H: Handler>(&mut self, handler: &Arc<H>) -> Result<(), StartError> {
        for index in 0..self.shared.workers {
            let (shared, handler) = (self.shared.clone(), handler.clone());
            let workspace = handler.workspace()?;
            let thread = thread::Builder::new().name(format!("egp-step-{index}"));
            self.workers
                .push(thread.spawn(move || work(&shared, &*handler, workspace))?);
        }
        Ok(())
    }

    fn start_offerer<H: Handler>(
        &mut self,
        handler: &Arc<H>,
        questions: Receiver<Asked<Received>>,
    ) -> Result<(), StartError> {
        let (shared, handler) = (self.shared.clone(), handler.clone());
        let thread = thread::Builder::new().name("egp-offer".to_owned());
        let offering = move || offer(&shared, &questions, |id| handler.content(id));
        self.offerer = Some(thread.spawn(offering)?);
        Ok(())
    }

    fn start_reporter(
        &mut self,
        period: Duration,
        links: Arc<Links>,
        twice: Counter,
    ) -> Result<(), StartError> {
        let reporter = Reporter {
            publisher: self.network.publisher(&keys::load(&self.shared.replica))?,
            surroundings: self.network.surroundings(),
            shared: self.shared.clone(),
            links,
            twice,
            period,
        };
        let (stop, stopped) = mpsc::channel();
        let thread = thread::Builder::new().name("egp-load".to_owned());
        let thread = thread.spawn(move || reporter.run(&stopped))?;
        self.reporter = Some((stop, thread));
        Ok(())
    }

    /// Stops network, threads and queue; a second call does nothing.
    fn stop(&mut self) {
        drop(self.reloader.take());
        self.network.undeclare();
        self.shared.queue.close();
        self.shared.offer.close();
        for thread in self.workers.drain(..).chain(self.offerer.take()) {
            join(thread);
        }
        drop(self.http.take());
        if let Some((stop, reporter)) = self.reporter.take() {
            drop(stop);
            join(reporter);
            self.network.close();
        }
    }
}

/// Makes what all threads of a service share. The first certificate expires at `end`, s since 1970.
fn share<H: Handler>(
    config: &ServiceConfig,
    handler: &Arc<H>,
    offer: Offer<Received>,
    end: Option<i64>,
    mut metrics: Metrics,
) -> Result<Arc<Shared<Received>>, StartError> {
    let workers = config.workers();
    let guard = config
        .vehicle_keys
        .as_deref()
        .map(Guard::load)
        .transpose()?;
    if let Some(guard) = &guard {
        metrics.show_twice(guard.twice());
    }
    if let Some(end) = end {
        certificates::show(end, metrics.registry());
    }
    let traces = Traces::open(config, config.share()?)?;
    if let Some(traces) = &traces {
        metrics.show_spans(traces.counts());
    }
    let described = handler.clone();
    let shared = Shared {
        replica: config.name()?,
        metrics,
        describe: Box::new(move || described.describe()),
        workers,
        queue: Queue::new(config.queue),
        standing: Standing::default(),
        draining: AtomicBool::new(false),
        guard,
        traces,
        offer,
    };
    Ok(Arc::new(shared))
}

impl Drop for Server {
    fn drop(&mut self) {
        self.network.withdraw();
        self.stop();
    }
}

/// Fetches the library of a configuration if it states one by its hash. `stopped` tells whether to give up.
fn fetch(config: &ServiceConfig, stopped: &mut dyn FnMut() -> bool) -> Result<(), FetchError> {
    let Some(wanted) = wanted(config) else {
        return Ok(());
    };
    if let Fetched::From(replica) = wanted.fetch(config, PATIENCE, stopped)? {
        let library = library::hex(&wanted.id);
        tracing::info!(library, %replica, file = %wanted.file.display(), "library fetched");
    }
    Ok(())
}

/// The library that a configuration states by its hash.
pub(crate) fn wanted(config: &ServiceConfig) -> Option<Wanted<'_>> {
    config.wanted().map(|id| Wanted {
        id,
        file: &config.library,
        keys: config.library_keys.as_deref(),
    })
}

/// Reads the keys of the vehicles again if the service has some. The log and the metrics tell the outcome.
fn read_keys(shared: &Shared<Received>, file: Option<&Path>) {
    let (Some(guard), Some(file)) = (&shared.guard, file) else {
        return;
    };
    let read = guard.reload(file);
    shared.metrics.keys_read(read.is_ok());
    match read {
        Ok(vehicles) => tracing::info!(vehicles, "keys of the vehicles read again"),
        Err(error) => {
            tracing::error!(%error, "the vehicles' keys could not be read again; the keys from before remain in use");
        }
    }
}

/// Tells log and metrics how a reload ended.
fn note(metrics: &Metrics, reloaded: Outcome) {
    match reloaded {
        Ok((Reloaded::Changed(id), all)) => {
            metrics.serve(&all);
            metrics.reloaded("changed");
            tracing::info!(
                library = library::hex(&id),
                served = all.len(),
                "library changed"
            );
        }
        Ok((Reloaded::Same(id), _)) => {
            metrics.reloaded("same");
            tracing::info!(library = library::hex(&id), "library is the same as before");
        }
        Err(error) => {
            metrics.reloaded("failed");
            tracing::error!(%error, "library not loaded; what was served before is still served");
        }
    }
}

fn join(thread: JoinHandle<()>) {
    if thread.join().is_err() {
        tracing::error!("a thread of the service ended by a panic");
    }
}

#[cfg(test)]
mod tests {
    use egp_wire::LibraryId;

    use super::*;

    #[test]
    fn metrics_tell_how_reloads_ended_and_what_is_served() {
        let (old, new): (LibraryId, LibraryId) = ([1; 32], [2; 32]);
        let metrics = Metrics::new(&[old], 1);
        note(&metrics, Ok((Reloaded::Same(old), vec![old])));
        note(&metrics, Err(ReloadError::NoFile));
        let served = |id: LibraryId| format!("{{sha256=\"{}\"}} 1", library::hex(&id));
        assert!(!metrics.text(0).contains(&served(new)));
        note(&metrics, Ok((Reloaded::Changed(new), vec![new, old])));
        let text = metrics.text(0);
        for outcome in ["same", "failed", "changed"] {
            let line = format!("egp_reloads_total{{outcome=\"{outcome}\"}} 1");
            assert!(text.contains(&line), "{line}: {text}");
        }
        assert!(
            text.contains(&served(old)) && text.contains(&served(new)),
            "{text}"
        );
    }
}
