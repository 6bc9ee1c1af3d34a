//! Whether a service has links to others: for its metrics, its log and its readiness.

use std::io;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use egp_session::NetworkError;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

use crate::background::Background;
use crate::configuration::{connects_to, is_client};
use crate::logging::show_lost;
use crate::metrics::shown;
use crate::network::{Config, Surroundings};

/// Longest time between two looks at the links.
pub(crate) const LOOK: Duration = Duration::from_millis(500);

/// Time without a link after which a service warns that nobody answers where it connects.
const FIRST: Duration = Duration::from_secs(5);
/// Time between two such warnings.
const AGAIN: Duration = Duration::from_secs(300);

/// The links of a service, as they were when they were last counted.
pub(crate) struct Links {
    count: Gauge<i64, AtomicI64>,
    /// The number before; negative before the first look.
    before: AtomicI64,
    /// Whether vehicles reach the service by its links only, because it listens nowhere.
    needed: bool,
    /// The endpoints that it connects to.
    endpoints: Vec<String>,
    /// When a warning is due that nobody answers there.
    due: Mutex<Instant>,
}

impl Links {
    /// The links of a session with this configuration, which its metrics show, beside the lines of the log that are lost.
    ///
    /// # Errors
    /// [`NetworkError`] if the configuration lacks a value.
    pub(crate) fn of(zenoh: &Config, registry: &mut Registry) -> Result<Arc<Self>, NetworkError> {
        show_lost(registry);
        let (needed, endpoints) = (is_client(zenoh)?, connects_to(zenoh)?);
        Ok(Arc::new(Self::new(needed, endpoints, registry)))
    }

    /// Shows the number of links in a metric. `needed` tells whether no vehicle can reach the service without links, and
    /// `endpoints` where it connects.
    pub(crate) fn new(needed: bool, endpoints: Vec<String>, registry: &mut Registry) -> Self {
        let help = "Sessions of zenoh that this one is connected to: routers, peers and clients";
        Self {
            count: shown(registry, "links", help),
            before: AtomicI64::new(-1),
            needed,
            endpoints,
            due: Mutex::new(Instant::now() + FIRST),
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
        if self.warns(links, Instant::now()) {
            tracing::warn!(
                endpoints = self.endpoints.join(" "),
                "nobody answers at connect/endpoints; it is tried again, so look whether a router or a service listens there \
                 and can be reached from here, and, with TLS, whether the certificates of both sides are of one authority"
            );
        }
    }

    /// Whether a warning is due that nobody answers where the service connects, which then counts as given at the time `now`. A
    /// service that is reached by its links only waits for them before it starts, and says when it has lost them.
    fn warns(&self, links: i64, now: Instant) -> bool {
        let mut due = self.due.lock().unwrap_or_else(PoisonError::into_inner);
        if links > 0 {
            *due = now + FIRST;
        }
        let warns = now >= *due && !self.needed && !self.endpoints.is_empty();
        if warns {
            *due = now + AGAIN;
        }
        warns
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
            let found = Links::new(needed, Vec::new(), &mut Registry::default());
            found.note(links);
            let state = found.not_ready(true);
            assert_eq!(state, expected, "needed {needed}, {links} links");
            assert_eq!(found.not_ready(false), Some("starting"));
        }
    }

    #[test]
    fn endpoints_that_nobody_answers_are_told_after_five_seconds_and_then_every_five_minutes() {
        let endpoints = || vec!["tcp/10.0.0.5:7447".to_owned()];
        let of = |needed, endpoints| Links::new(needed, endpoints, &mut Registry::default());
        let (found, start) = (of(false, endpoints()), Instant::now());
        for (links, seconds, warns) in [
            (0, 4, false),
            (0, 6, true),
            (0, 7, false),
            (0, 305, false),
            (0, 307, true),
            (1, 308, false),
            (0, 312, false),
            (0, 314, true),
        ] {
            let now = start + Duration::from_secs(seconds);
            assert_eq!(
                found.warns(links, now),
                warns,
                "{links} links at {seconds} s"
            );
        }
        let late = start + Duration::from_secs(60);
        assert!(!of(false, Vec::new()).warns(0, late));
        assert!(!of(true, endpoints()).warns(0, late));
    }
}
