//! What became of replayed requests.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use egp_wire::{MessageLimits, Reply, Status, Timing, WireError};
use prost::Message as _;

use crate::tally::Micros;

/// Counts and times of the requests that are due while it is measured.
#[derive(Default)]
pub(crate) struct Counts {
    /// Number of requests by their outcome; `solved` are those whose plan came in time.
    pub(crate) outcomes: BTreeMap<String, u64>,
    /// Requests of each vehicle, and those of them whose plan came in time.
    pub(crate) vehicles: Vec<[u64; 2]>,
    /// Time from when a request was due to its answer, late answers and errors included.
    pub(crate) latency: Micros,
    /// Time in the service's queue.
    pub(crate) queue: Micros,
    /// Time in the service's worker.
    pub(crate) step: Micros,
    /// Time from when a request was due to when it was sent.
    pub(crate) lag: Micros,
}

/// A request that was sent; if no answer has come when it is dropped, the outcome is `no answer`.
pub(crate) struct Sent {
    pub(crate) due: Instant,
    pub(crate) vehicle: usize,
    pub(crate) budget: Duration,
    pub(crate) counts: Arc<Mutex<Counts>>,
    pub(crate) answered: AtomicBool,
}

impl Sent {
    /// Counts the reply with this payload and attachment.
    pub(crate) fn replied(&self, payload: &[u8], attachment: &[u8]) {
        let latency = self.due.elapsed();
        let status = Reply::decode(payload, &MessageLimits::default()).map(|reply| reply.status);
        let outcome = match status {
            Ok(Status::Solved) if latency > self.budget => "late".to_owned(),
            Ok(status) => status
                .as_str_name()
                .trim_start_matches("STATUS_")
                .to_ascii_lowercase(),
            Err(_) => "unusable".to_owned(),
        };
        self.count(outcome, Some(latency), Timing::decode(attachment).ok());
    }

    /// Counts an error reply with this payload; zenoh's own errors are no `egp.v1.Error`.
    pub(crate) fn refused(&self, payload: &[u8]) {
        let outcome = match WireError::decode(payload) {
            Ok(error) => format!("refused: {}", error.code_name()),
            Err(_) => "timeout".to_owned(),
        };
        self.count(outcome, Some(self.due.elapsed()), None);
    }

    fn count(&self, outcome: String, latency: Option<Duration>, timing: Option<Timing>) {
        if self.answered.swap(true, Ordering::Relaxed) {
            return;
        }
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(vehicle) = counts.vehicles.get_mut(self.vehicle) {
            vehicle[0] += 1;
            vehicle[1] += u64::from(outcome == "solved");
        }
        if let Some(latency) = latency {
            counts.latency.record(latency);
        }
        if let Some(timing) = timing {
            counts
                .queue
                .record(Duration::from_micros(timing.queue_us.into()));
            counts
                .step
                .record(Duration::from_micros(timing.step_us.into()));
        }
        *counts.outcomes.entry(outcome).or_default() += 1;
    }
}

impl Drop for Sent {
    fn drop(&mut self) {
        self.count("no answer".to_owned(), None, None);
    }
}
