//! What became of replayed requests.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use egp_wire::{Code, Reply, Status, Timing, WireError, code_name, status_name};
use prost::Message as _;

use crate::tally::Micros;

/// Counts and times of the requests that are due while it is measured.
#[derive(Default)]
pub(crate) struct Counts {
    /// Number of requests by their outcome; `solved` are those whose plan came in time.
    pub(crate) outcomes: BTreeMap<String, u64>,
    /// Requests of each vehicle, and those of them whose plan came in time.
    pub(crate) vehicles: Vec<[u64; 2]>,
    /// Time from when a request was due to its reply, also to a late one; requests that were refused have none.
    pub(crate) latency: Micros,
    /// Time in the service's queue.
    pub(crate) queue: Micros,
    /// Time in the service's worker.
    pub(crate) step: Micros,
    /// Time from when a request was due to when it was sent.
    pub(crate) lag: Micros,
}

/// A request that was sent. If no answer has come when it is dropped, the outcome is `no answer`, or the error about a copy.
pub(crate) struct Sent {
    pub(crate) due: Instant,
    pub(crate) vehicle: usize,
    pub(crate) budget: Duration,
    pub(crate) counts: Arc<Mutex<Counts>>,
    pub(crate) answered: AtomicBool,
    /// Whether an error came that a copy of the request may have got while another copy is answered.
    pub(crate) copied: AtomicBool,
}

impl Sent {
    /// Counts the reply with this payload and attachment.
    pub(crate) fn replied(&self, payload: &[u8], attachment: &[u8]) {
        let latency = self.due.elapsed();
        let status = Reply::decode(payload).map(|reply| reply.status);
        let outcome = match status {
            Ok(Status::Solved) if latency > self.budget => "late".to_owned(),
            Ok(status) => status_name(status).to_owned(),
            Err(_) => "unusable".to_owned(),
        };
        let timing = (!attachment.is_empty()).then(|| Timing::decode(attachment).ok());
        self.count(outcome, status.is_ok().then_some(latency), timing.flatten());
    }

    /// Counts an error reply with this payload; zenoh's own errors are no `egp.v1.Error`.
    ///
    /// Two routers deliver a request twice, and the service answers one of the copies with an error that says so. Such an
    /// error counts only if the query ends without another answer.
    pub(crate) fn refused(&self, payload: &[u8]) {
        match WireError::decode(payload).map(|error| error.code) {
            Ok(Code::Superseded) => self.copied.store(true, Ordering::Relaxed),
            Ok(code) => self.count(refused(code), None, None),
            Err(_) => self.count("timeout".to_owned(), None, None),
        }
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
        let outcome = if *self.copied.get_mut() {
            refused(Code::Superseded)
        } else {
            "no answer".to_owned()
        };
        self.count(outcome, None, None);
    }
}

fn refused(code: Code) -> String {
    format!("refused: {}", code_name(code))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use egp_testing::messages;

    use super::*;

    fn sent(counts: &Arc<Mutex<Counts>>) -> Sent {
        Sent {
            due: Instant::now(),
            vehicle: 0,
            budget: Duration::from_secs(3600),
            counts: counts.clone(),
            answered: AtomicBool::new(false),
            copied: AtomicBool::new(false),
        }
    }

    /// What is counted after error replies with these codes, and a reply behind them if there is one. Only the reply has a
    /// latency.
    fn counted(codes: &[Code], reply: Option<&Reply>) -> Vec<(String, u64)> {
        let counts = Arc::new(Mutex::new(Counts::default()));
        let sent = sent(&counts);
        for code in codes {
            sent.refused(&WireError::permanent(*code, "").encode());
        }
        if let Some(reply) = reply {
            sent.replied(&reply.encode(), &[]);
        }
        drop(sent);
        let counts = counts.lock().unwrap();
        let latencies = u64::from(counts.outcomes.contains_key("solved"));
        assert_eq!(counts.latency.len(), latencies);
        counts.outcomes.clone().into_iter().collect()
    }

    #[test]
    fn a_timeout_of_zenoh_has_no_latency() {
        let counts = Arc::new(Mutex::new(Counts::default()));
        sent(&counts).refused(b"Timeout");
        let counts = counts.lock().unwrap();
        assert_eq!((counts.outcomes["timeout"], counts.latency.len()), (1, 0));
    }

    #[test]
    fn an_error_about_a_copy_counts_only_if_the_query_ends_without_another_answer() {
        let solved = messages::solved_reply();
        let one = |outcome: &str| vec![(outcome.to_owned(), 1)];
        assert_eq!(counted(&[], None), one("no answer"));
        let copied = Code::Superseded;
        assert_eq!(counted(&[copied], Some(&solved)), one("solved"));
        assert_eq!(counted(&[copied], None), one("refused: superseded"));
        let late = counted(&[copied, Code::TooLate], None);
        assert_eq!(late, one("refused: too_late"));
        let first = counted(&[Code::TooLate], Some(&solved));
        assert_eq!(first, one("refused: too_late"));
    }
}
