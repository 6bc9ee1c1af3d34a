//! A replica without network, threads and clock, for simulations.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use egp_wire::keys::Name;
use egp_wire::{KeyRing, Status, WireError};

use crate::guard::Guard;
use crate::handler::Handler;
use crate::intake::Shared;
use crate::metrics::Metrics;
use crate::offer::Offer;
use crate::query::Query;
use crate::queue::Queue;
use crate::worker::{Begun, Worker};

/// Intake, queue and workers of a service as one state machine; [`crate::Server`] runs the same code on threads.
///
/// The caller delivers queries, and gives the time with each call. Only differences between times matter.
pub struct Replica<H: Handler, Q: Query> {
    shared: Shared<Q>,
    handler: Arc<H>,
    workers: Vec<Worker<H::Workspace>>,
    /// The step that each worker computes, with its outcome.
    running: Vec<Option<Computed<Q>>>,
}

type Computed<Q> = (Begun<Q>, Result<Status, WireError>);

impl<H: Handler, Q: Query> Replica<H, Q> {
    /// A replica with this name, number of workers and number of vehicles that may wait.
    ///
    /// # Errors
    /// [`WireError`] if the memory of a worker cannot be made.
    pub fn new(name: Name, handler: H, workers: usize, queue: usize) -> Result<Self, WireError> {
        let handler = Arc::new(handler);
        let described = handler.clone();
        let memory = (0..workers).map(|_| handler.workspace().map(Worker::new));
        let workers_memory = memory.collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            shared: Shared {
                replica: name,
                metrics: Metrics::new(&handler.describe().libraries(), workers),
                describe: Box::new(move || described.describe()),
                workers,
                queue: Queue::new(queue),
                draining: AtomicBool::new(false),
                guard: None,
                traces: None,
                offer: Offer::none(),
            },
            handler,
            workers: workers_memory,
            running: (0..workers).map(|_| None).collect(),
        })
    }

    /// Answers only requests that are sealed with these keys of their vehicles, as a service with `vehicle_keys` does.
    #[must_use]
    pub fn with_keys(mut self, keys: KeyRing) -> Self {
        self.shared.guard = Some(Guard::new(keys));
        self
    }

    /// Takes a query at the time `now`: answers it, queues it, or answers it with an error.
    pub fn take(&self, query: Q, now: Instant) {
        self.shared.take(query, now);
    }

    /// Lets an idle worker begin the next step at the time `now`, and returns the worker's index; none if no worker is
    /// idle or no request waits. The caller calls [`Replica::end`] when the step's time has passed.
    pub fn begin(&mut self, now: Instant) -> Option<usize> {
        let index = self.running.iter().position(Option::is_none)?;
        loop {
            let job = self.shared.queue.try_pop()?;
            if let Some(begun) = self.shared.begin(job, now) {
                let worker = self.workers.get_mut(index)?;
                let outcome = worker.compute(&self.shared, &*self.handler, &begun);
                *self.running.get_mut(index)? = Some((begun, outcome));
                return Some(index);
            }
        }
    }

    /// Ends the step of the worker with this index at the time `now`, and answers its query.
    pub fn end(&mut self, index: usize, now: Instant) {
        let computed = self.running.get_mut(index).and_then(Option::take);
        if let (Some((begun, outcome)), Some(worker)) = (computed, self.workers.get(index)) {
            self.shared.finish(begun, &outcome, &worker.reply, now);
        }
    }

    /// Begins to drain: the replica describes itself as not ready, and still serves.
    pub fn drain(&self) {
        self.shared.draining.store(true, Ordering::Relaxed);
    }

    /// Closes the queue: later requests are answered with an error, those that wait are still served.
    pub fn close(&self) {
        self.shared.queue.close();
    }

    /// Vehicles that wait.
    pub fn waiting(&self) -> usize {
        self.shared.queue.len()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use egp_wire::Code;

    use super::*;
    use crate::query::recorded::{Echo, Recorded, Sent, at, name};

    fn replica(workers: usize) -> Replica<Echo, Recorded> {
        Replica::new(name("main"), Echo::default(), workers, 2).unwrap()
    }

    fn taken(replica: &Replica<Echo, Recorded>, vehicle: &str, now: Instant) -> Recorded {
        let query = Recorded::request(vehicle, 5, 1_000_000);
        replica.take(query.clone(), now);
        query
    }

    #[test]
    fn idle_workers_begin_what_waits_and_answer_when_they_end() {
        let (mut replica, start) = (replica(2), Instant::now());
        assert_eq!(replica.begin(start), None);
        let [a, b] = ["a", "b"].map(|vehicle| taken(&replica, vehicle, start));
        assert_eq!(replica.waiting(), 2);
        assert_eq!(
            [replica.begin(start), replica.begin(start)],
            [Some(0), Some(1)]
        );
        let c = taken(&replica, "c", start);
        assert_eq!((replica.begin(start), replica.waiting()), (None, 1));
        assert_eq!((a.sent(), b.sent()), (None, None));
        replica.end(1, at(start, 3.0));
        assert_eq!(a.sent(), None);
        let Some(Sent::Answer {
            payload,
            timing: Some(timing),
            ..
        }) = b.sent()
        else {
            unreachable!("{:?}", b.sent());
        };
        assert_eq!((payload.as_slice(), timing.step_us), (&b"1:5"[..], 3_000));
        assert_eq!(replica.begin(start), Some(1));
        replica.end(1, start);
        assert!(c.sent().is_some());
    }

    #[test]
    fn a_request_whose_time_has_passed_is_not_begun() {
        let (mut replica, start) = (replica(1), Instant::now());
        let late = taken(&replica, "a", start);
        assert_eq!(replica.begin(at(start, 1_001.0)), None);
        assert_eq!(late.code(), Some(Code::TooLate));
    }

    #[test]
    fn a_replica_that_drains_serves_until_it_is_closed() {
        let (mut replica, start) = (replica(1), Instant::now());
        replica.drain();
        assert!(replica.shared.draining.load(Ordering::Relaxed));
        let served = taken(&replica, "a", start);
        replica.close();
        assert_eq!(taken(&replica, "b", start).code(), Some(Code::Draining));
        assert_eq!(replica.begin(start), Some(0));
        replica.end(0, start);
        assert!(matches!(served.sent(), Some(Sent::Answer { .. })));
    }

    #[test]
    fn a_replica_with_keys_answers_sealed_requests_only() {
        let ring = KeyRing::parse(&format!("fleet/a {}", "a1".repeat(32))).unwrap();
        let replica = replica(1).with_keys(ring);
        let query = taken(&replica, "a", Instant::now());
        assert_eq!(query.code(), Some(Code::Unauthenticated));
    }
}
