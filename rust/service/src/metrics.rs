//! The metrics of the service, as OpenMetrics text.

use std::time::Duration;

use egp_core::library;
use egp_trace::Counts;
use egp_wire::{Code, LibraryId, Status, code_name, status_name};
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Metric, Registry, Unit};

use crate::sync::atomic::{AtomicU32, Ordering};
use crate::sync::{Mutex, PoisonError};

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
pub(crate) struct Outcome {
    outcome: &'static str,
}

/// A counter for each outcome.
pub(crate) type Outcomes = Family<Outcome, Counter>;

/// Counts one of these outcomes.
pub(crate) fn count(counters: &Outcomes, outcome: &'static str) {
    counters.get_or_create(&Outcome { outcome }).inc();
}

/// A metric that starts at its default and is shown under this name.
pub(crate) fn shown<M: Metric + Clone + Default>(
    registry: &mut Registry,
    name: &str,
    help: &str,
) -> M {
    let metric = M::default();
    registry.register(name, help, metric.clone());
    metric
}

/// The OpenMetrics text of all metrics of a registry.
pub(crate) fn text(registry: &Registry) -> String {
    let mut text = String::new();
    match encode(&mut text, registry) {
        Ok(()) => text,
        Err(error) => format!("# {error}\n# EOF\n"),
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Sha256 {
    sha256: String,
}

/// Counters, histograms and the running estimate of a step's time.
pub(crate) struct Metrics {
    registry: Registry,
    requests: Outcomes,
    panics: Counter,
    step: Histogram,
    queue: Histogram,
    queued: Gauge,
    pub(crate) busy: Gauge,
    step_us: AtomicU32,
    libraries: Family<Sha256, Gauge>,
    reloads: Outcomes,
    offers: Outcomes,
    key_reloads: Outcomes,
    /// Spans by what became of them, and where they are counted; none if no traces are written.
    spans: Option<Mutex<(Outcomes, Counts)>>,
}

impl Metrics {
    pub(crate) fn new(libraries: &[LibraryId], workers: usize) -> Self {
        // The buckets begin at 0.1 ms, a step of two small members, and end at 0.4 s, which is longer than any control period.
        let seconds = || Histogram::new(exponential_buckets(1e-4, 2.0, 13));
        let mut registry = Registry::with_prefix("egp");
        let all = &mut registry;
        let requests = shown(all, "requests", "Requests by solver status or error code");
        let panics = shown(all, "panics", "Control steps that panicked");
        let (step, help) = (seconds(), "Decoding, control step and encoding");
        all.register_with_unit("step", help, Unit::Seconds, step.clone());
        let (queue, help) = (seconds(), "From arrival to a worker");
        all.register_with_unit("queue", help, Unit::Seconds, queue.clone());
        let queued = shown(all, "queued", "Vehicles that wait");
        let busy = shown(all, "busy", "Workers that compute a step");
        let count: Gauge = shown(all, "workers", "Workers");
        count.set(i64::try_from(workers).unwrap_or(i64::MAX));
        let metrics = Self {
            requests,
            panics,
            step,
            queue,
            queued,
            busy,
            step_us: AtomicU32::new(0),
            libraries: shown(all, "library_info", "The libraries served"),
            reloads: shown(all, "reloads", "Reloads of the library file"),
            offers: shown(all, "library_questions", "Questions for library files"),
            key_reloads: shown(all, "key_reloads", "Reloads of the vehicles' keys"),
            spans: None,
            registry,
        };
        metrics.serve(libraries);
        metrics
    }

    /// Shows the counter of clients that use one key by turns.
    pub(crate) fn show_twice(&mut self, twice: Counter) {
        let help = "Turns of several clients with the key of one vehicle";
        self.registry.register("identity_twice", help, twice);
    }

    /// Shows the counter of services with the name of this one.
    pub(crate) fn show_name_twice(&mut self) -> Counter {
        let help = "Questions of each minute that another service of this name answered, too";
        shown(&mut self.registry, "name_twice", help)
    }

    /// The registry, in which other modules register their metrics.
    pub(crate) fn registry(&mut self) -> &mut Registry {
        &mut self.registry
    }

    /// Shows what becomes of spans.
    pub(crate) fn show_spans(&mut self, counts: Counts) {
        let help = "Spans of traces by what became of them";
        let family = shown(&mut self.registry, "spans", help);
        self.spans = Some(Mutex::new((family, counts)));
    }

    /// Shows the libraries that are served from now on.
    pub(crate) fn serve(&self, libraries: &[LibraryId]) {
        self.libraries.clear();
        for id in libraries {
            let sha256 = library::hex(id);
            self.libraries.get_or_create(&Sha256 { sha256 }).set(1);
        }
    }

    /// Counts a reload by its outcome.
    pub(crate) fn reloaded(&self, outcome: &'static str) {
        count(&self.reloads, outcome);
    }

    /// Counts a reload of the vehicles' keys.
    pub(crate) fn keys_read(&self, read: bool) {
        count(&self.key_reloads, if read { "read" } else { "failed" });
    }

    /// Counts a question for a library file or a part of it.
    pub(crate) fn offered(&self, sent: bool) {
        count(&self.offers, if sent { "sent" } else { "refused" });
    }

    pub(crate) fn answered(&self, status: Status) {
        count(&self.requests, status_name(status));
    }

    pub(crate) fn refused(&self, code: Code) {
        count(&self.requests, code_name(code));
    }

    pub(crate) fn panicked(&self) {
        self.panics.inc();
    }

    pub(crate) fn waited(&self, time: Duration) {
        self.queue.observe(time.as_secs_f64());
    }

    /// Records the time of a step and moves the estimate towards it, by an eighth of the estimate at most, so that one
    /// delayed step does not lead to errors for the next requests.
    pub(crate) fn stepped(&self, time: Duration) {
        self.step.observe(time.as_secs_f64());
        let (new, old) = (micros(time), self.step_us.load(Ordering::Relaxed));
        let reach = (old / 8).max(1);
        let moved = new.clamp(old.saturating_sub(reach), old.saturating_add(reach));
        // Workers may overwrite each other's estimates here, and each of those is valid.
        self.step_us
            .store(if old == 0 { new } else { moved }, Ordering::Relaxed);
    }

    /// Smoothed time of a step; zero before the first.
    pub(crate) fn step_time(&self) -> Duration {
        Duration::from_micros(self.step_us.load(Ordering::Relaxed).into())
    }

    pub(crate) fn busy_workers(&self) -> usize {
        usize::try_from(self.busy.get()).unwrap_or(0)
    }

    /// The OpenMetrics text.
    pub(crate) fn text(&self, queued: usize) -> String {
        self.queued.set(i64::try_from(queued).unwrap_or(i64::MAX));
        if let Some(spans) = &self.spans {
            // Two threads that show a count at once would both add what is missing.
            let (family, counts) = &*spans.lock().unwrap_or_else(PoisonError::into_inner);
            for (outcome, count) in [
                ("written", counts.written()),
                ("dropped", counts.dropped()),
                ("failed", counts.failed()),
            ] {
                let shown = family.get_or_create(&Outcome { outcome });
                shown.inc_by(count.saturating_sub(shown.get()));
            }
        }
        text(&self.registry)
    }
}

/// Whole microseconds, for the wire.
pub(crate) fn micros(time: Duration) -> u32 {
    u32::try_from(time.as_micros()).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_estimate_follows_steps_but_not_one_outlier() {
        let metrics = Metrics::new(&[], 1);
        metrics.stepped(Duration::from_millis(2));
        metrics.stepped(Duration::from_secs(5));
        assert_eq!(metrics.step_time(), Duration::from_micros(2250));
        for _ in 0..50 {
            metrics.stepped(Duration::from_millis(10));
        }
        assert_eq!(metrics.step_time(), Duration::from_millis(10));
    }
}
