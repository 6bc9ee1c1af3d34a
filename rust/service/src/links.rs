//! Whether a service has links to others: for its metrics, its log and its readiness.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

use crate::network::Surroundings;

/// Longest time between two looks at the links.
pub(crate) const LOOK: Duration = Duration::from_millis(500);

/// The links of a service, as they were when somebody looked last.
pub(crate) struct Links {
    count: Gauge<i64, AtomicI64>,
    /// The number before; negative before the first look.
    before: AtomicI64,
    /// Whether vehicles reach the service by its links only, because it listens nowhere.
    needed: bool,
}

impl Links {
    /// Shows the number of links in a metric. `needed` tells whether a service without links can be reached by nobody.
    pub(crate) fn new(needed: bool, registry: &mut Registry) -> Self {
        let count = Gauge::default();
        let help = "Sessions of zenoh that this one is connected to: routers, peers and clients";
        registry.register("links", help, count.clone());
        Self {
            count,
            before: AtomicI64::new(-1),
            needed,
        }
    }

    /// Takes the number of links now. The log tells when the last one was lost, and when one is there again.
    pub(crate) fn note(&self, links: usize) {
        let links = i64::try_from(links).unwrap_or(i64::MAX);
        self.count.set(links);
        let before = self.before.swap(links, Ordering::Relaxed);
        if before > 0 && links == 0 && self.needed {
            tracing::error!(
                "the link to the router is lost, and no vehicle reaches this service; it connects again by itself, so look \
                 whether the routers of connect/endpoints run and can be reached"
            );
        } else if before > 0 && links == 0 {
            tracing::info!("no link is left: no vehicle and no router is connected");
        } else if before == 0 && links > 0 {
            tracing::info!(links, "connected");
        }
    }

    /// Whether nobody can reach the service.
    pub(crate) fn are_lost(&self) -> bool {
        self.needed && self.count.get() == 0
    }
}

/// A thread that looks at the links until this value is dropped.
pub(crate) struct Watch {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Watch {
    /// Starts the thread.
    ///
    /// # Errors
    /// If the system cannot start it.
    pub(crate) fn start(links: Arc<Links>, surroundings: Surroundings) -> io::Result<Self> {
        let (stop, stopped) = mpsc::channel::<()>();
        let thread = thread::Builder::new().name("egp-links".to_owned());
        let thread = thread.spawn(move || {
            while stopped.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
                links.note(surroundings.links());
            }
        })?;
        Ok(Self {
            stop: Some(stop),
            thread: Some(thread),
        })
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        drop(self.stop.take());
        if self
            .thread
            .take()
            .is_some_and(|thread| thread.join().is_err())
        {
            tracing::error!("the thread that looks at the links ended by a panic");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_service_that_listens_is_never_cut_off() {
        for (needed, links, lost) in [
            (true, 0, true),
            (true, 2, false),
            (false, 0, false),
            (false, 2, false),
        ] {
            let found = Links::new(needed, &mut Registry::default());
            found.note(links);
            assert_eq!(found.are_lost(), lost, "needed {needed}, {links} links");
        }
    }
}
