//! From a query to the queue. Runs on the network's receive thread, so it decodes headers only.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use egp_wire::keys::{self, Name, Target};
use egp_wire::{Code, Header, Invalid, Load, MessageLimits, Ready, Timing, WireError};
use prost::Message as _;

use crate::events;
use crate::guard::{Guard, Sealed};
use crate::metrics::{Metrics, micros};
use crate::query::Query;
use crate::queue::{Queue, Refused};

/// The part of a budget that is left for the way of request and answer through network and threads, which the service
/// does not see. Without it, a service with too many requests computes answers that are late by little.
const TRANSIT: u32 = 8;

/// A request on its way to a worker.
pub(crate) struct Job<Q> {
    pub(crate) query: Q,
    pub(crate) sequence: u64,
    pub(crate) arrived: Instant,
    pub(crate) deadline: Instant,
    /// The proof of the sender, if the service has keys.
    pub(crate) sealed: Option<Sealed>,
}

impl<Q> Job<Q> {
    /// The time by which a step must be expected to end, unless the worker would otherwise be idle.
    pub(crate) fn expected_by(&self) -> Instant {
        self.arrived + (self.deadline - self.arrived) * (TRANSIT - 1) / TRANSIT
    }
}

/// The state that intake and workers share.
pub(crate) struct Shared<Q> {
    pub(crate) replica: Name,
    /// What the replica serves now.
    pub(crate) describe: Box<dyn Fn() -> Ready + Send + Sync>,
    pub(crate) workers: usize,
    pub(crate) queue: Queue<Job<Q>>,
    pub(crate) metrics: Metrics,
    pub(crate) draining: AtomicBool,
    /// The keys of the vehicles; without them every sender is served.
    pub(crate) guard: Option<Guard>,
}

impl<Q: Query> Shared<Q> {
    /// Answers a query that arrived at `arrived`, queues it, or answers it with an error.
    pub(crate) fn take(&self, query: Q, arrived: Instant) {
        match keys::parse(query.key()) {
            Some(Target::Health) => {
                let key = keys::health(&self.replica);
                query.answer(&key, b"ok".to_vec(), "text/plain", None);
            }
            Some(Target::Ready) => {
                let mut description = (self.describe)();
                description.ready = !self.draining.load(Ordering::Relaxed);
                let encoding = "application/protobuf;egp.v1.Ready";
                let (key, answer) = (keys::ready(&self.replica), description.encode());
                let sealed = self.guard.as_ref().and_then(|guard| guard.question(&query));
                let attachment = sealed.map(|sealed| {
                    let tag = sealed.tag(&answer);
                    Timing {
                        tag,
                        ..Timing::default()
                    }
                    .encode_to_vec()
                });
                query.answer(&key, answer, encoding, attachment);
            }
            Some(Target::Metrics) => {
                let text = self.metrics.text(self.queue.len()).into_bytes();
                let encoding = "application/openmetrics-text;version=1.0.0";
                query.answer(&keys::metrics(&self.replica), text, encoding, None);
            }
            Some(Target::Step { fleet, vehicle }) => self.admit(query, arrived, &fleet, &vehicle),
            None => self.refuse(&query, None, &no_such_key(query.key())),
        }
    }

    fn admit(&self, query: Q, arrived: Instant, fleet: &Name, vehicle: &Name) {
        if query.key() != keys::step(&self.replica, fleet, vehicle) {
            return self.refuse(&query, None, &no_such_key(query.key()));
        }
        let limits = MessageLimits::default();
        let (limit, actual) = (limits.message_bytes, query.length());
        if actual > limit {
            // The payload is not read: several parts of it would be copied first.
            return self.refuse(&query, None, &Invalid::TooLarge { limit, actual }.into());
        }
        let header = match Header::decode(&query.payload(), &limits) {
            Ok(header) => header,
            Err(invalid) => return self.refuse(&query, None, &invalid.into()),
        };
        let sealed = match self
            .guard
            .as_ref()
            .map(|guard| guard.request(&query, fleet, vehicle))
        {
            Some(Ok(sealed)) => Some(sealed),
            Some(Err(error)) => return self.refuse(&query, Some(header.sequence), &error),
            None => None,
        };
        let deadline = arrived + Duration::from_micros(header.budget_us.into());
        let job = Job {
            query,
            sequence: header.sequence,
            arrived,
            deadline,
            sealed,
        };
        // An idle worker tries in any case, because only computed steps correct the estimate.
        let idle = |ahead| ahead + self.metrics.busy_workers() < self.workers;
        let expected_by = job.expected_by();
        let in_time = |ahead| idle(ahead) || arrived + self.time_to_answer(ahead) <= expected_by;
        let pushed = self
            .queue
            .push(format!("{fleet}/{vehicle}"), deadline, job, in_time);
        if let Some(old) = pushed.superseded {
            let detail = "a newer request of this vehicle took the place of this one";
            self.refuse_job(&old, &WireError::permanent(Code::Superseded, detail));
        }
        match pushed.queued {
            Ok(()) => {}
            Err(Refused::Full(job)) => self.refuse_job(&job, &self.overloaded()),
            Err(Refused::Late(job)) => self.refuse_job(&job, &self.too_late(header.budget_us)),
            Err(Refused::Closed(job)) => self.refuse_job(
                &job,
                &WireError::retryable(Code::Draining, 0, "this replica is going away, ask another"),
            ),
        }
    }

    /// The expected time of an answer behind `ahead` waiting requests, from the smoothed time of a step.
    fn time_to_answer(&self, ahead: usize) -> Duration {
        let rounds = 1 + (ahead + self.metrics.busy_workers()) / self.workers;
        self.metrics.step_time() * u32::try_from(rounds).unwrap_or(u32::MAX)
    }

    fn overloaded(&self) -> WireError {
        let queued = self.queue.len();
        let wait = micros(self.time_to_answer(queued));
        let detail = format!("{queued} vehicles are waiting already; ask another replica");
        WireError::retryable(Code::Overloaded, wait, detail)
    }

    pub(crate) fn too_late(&self, budget_us: u32) -> WireError {
        let wait = micros(self.time_to_answer(self.queue.len()));
        let detail = format!("no answer within {budget_us} us; allow more, or ask another replica");
        WireError::retryable(Code::TooLate, wait, detail)
    }

    /// Answers a request that was queued with an error.
    pub(crate) fn refuse_job(&self, job: &Job<Q>, error: &WireError) {
        self.refuse(&job.query, Some(job.sequence), error);
    }

    /// Sends an error and counts it.
    fn refuse(&self, query: &Q, sequence: Option<u64>, error: &WireError) {
        self.metrics.refused(error.code);
        events::refused(query.key(), sequence, error);
        query.refuse(error);
    }

    /// The load, which is published for clients that choose among replicas.
    pub(crate) fn load(&self) -> Load {
        let count = |n| u32::try_from(n).unwrap_or(u32::MAX);
        Load {
            queued: count(self.queue.len()),
            busy: count(self.metrics.busy_workers()),
            workers: count(self.workers),
            step_us: micros(self.metrics.step_time()),
        }
    }
}

fn no_such_key(key: &str) -> WireError {
    let detail = format!(
        "{key} is no key of this replica: expected egp/v1/r/REPLICA/FLEET/VEHICLE/step or \
         egp/v1/r/REPLICA/health, ready or metrics"
    );
    WireError::permanent(Code::Malformed, detail)
}
