//! Whether a service has links to others: for its metrics, its log and its readiness.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::Duration;

use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

use crate::background::Background;
use crate::network::Surroundings;

/// Longest time between two looks at the links.
pub(crate) const LOOK: Duration = Duration::from_millis(500);

/// The links of a service, as they were when they were last counted.
pub(crate) struct Links {
    count: Gauge<i64, AtomicI64>,
    /// The number before; negative before the first look.
    before: AtomicI64,
    /// Whether vehicles reach the service by its links only, because it listens nowhere.
    needed: bool,
}

impl Links {
    /// Shows the number of links in a metric. `needed` tells whether no vehicle can reach the service without links.
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

    /// Why no vehicle can reach a service, in one word for its page; none if vehicles can. `serving` tells whether the service
    /// has begun to serve.
    pub(crate) fn not_ready(&self, serving: bool) -> Option<&'static str> {
        if !serving {
            Some("starting")
        } else if self.needed && self.count.get() == 0 {
            Some("disconnected")
        } else {
            None
        }
    }
}

/// Takes the number of links twice a second in a thread of its own, until the value that is returned is dropped.
///
/// # Errors
/// If the system cannot start the thread.
pub(crate) fn watch(links: Arc<Links>, surroundings: Surroundings) -> io::Result<Watch> {
    let (stop, stopped) = mpsc::channel::<()>();
    Background::start("egp-links", stop, move || {
        while stopped.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
            links.note(surroundings.links());
        }
    })
}

/// The thread of [`watch`].
pub(crate) type Watch = Background<Sender<()>>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_service_that_listens_is_never_cut_off() {
        for (needed, links, expected) in [
            (true, 0, Some("disconnected")),
            (true, 2, None),
            (false, 0, None),
            (false, 2, None),
        ] {
            let found = Links::new(needed, &mut Registry::default());
            found.note(links);
            let state = found.not_ready(true);
            assert_eq!(state, expected, "needed {needed}, {links} links");
            assert_eq!(found.not_ready(false), Some("starting"));
        }
    }
}
