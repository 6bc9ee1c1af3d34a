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
use crate::standing::Standing;
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
                standing: Standing::default(),
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

    const PERIOD: f64 = 20.0;
    const STEP: f64 = 0.25;

    /// What fraction of the worker's time went into answers in time, and the fraction of the requests of a vehicle that were
    /// answered in time, at least and in the mean. Times are in ms.
    struct Goodput {
        used: f64,
        least: f64,
        mean: f64,
    }

    /// One worker with a step of 0.25 ms and vehicles at 50 Hz for two seconds, of which the second counts. Budgets are 16 ms
    /// from when a request was sent; request and answer are each `transit` under way. Each vehicle's requests are up to 2 ms
    /// early or late. At most `queue` vehicles wait.
    fn loaded(vehicles: u32, queue: usize, transit: f64) -> Goodput {
        let mut replica = Replica::new(name("main"), Echo::default(), 1, queue).unwrap();
        let start = Instant::now();
        let mut arrivals = Vec::new();
        let mut random = 1_u64;
        for round in 0..100_u32 {
            for vehicle in 0..vehicles {
                random = random
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                let early = f64::from((random >> 33) as u32) / f64::from(1_u32 << 31) * 2.0;
                let part = f64::from(vehicle) / f64::from(vehicles);
                let sent = PERIOD * (f64::from(round) + part) + early;
                arrivals.push((sent + transit, vehicle, u64::from(round) + 100));
            }
        }
        arrivals.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut queries, mut ends): (Vec<(u32, f64, Recorded)>, Option<f64>) = (Vec::new(), None);
        for (now, vehicle, sequence) in arrivals {
            while let Some(end) = ends.filter(|end| *end <= now) {
                replica.end(0, at(start, end));
                ends = replica.begin(at(start, end)).map(|_| end + STEP);
            }
            let query = Recorded::request(&format!("car-{vehicle}"), sequence, 16_000);
            replica.take(query.clone(), at(start, now));
            if ends.is_none() {
                ends = replica.begin(at(start, now)).map(|_| now + STEP);
            }
            queries.push((vehicle, now, query));
        }
        while let Some(end) = ends {
            replica.end(0, at(start, end));
            ends = replica.begin(at(start, end)).map(|_| end + STEP);
        }
        let mut counts = vec![(0_u32, 0_u32); vehicles as usize];
        for (vehicle, _, query) in queries.iter().filter(|(_, now, _)| *now >= 1000.0) {
            let count = &mut counts[*vehicle as usize];
            count.0 += 1;
            if let Some(Sent::Answer { timing, .. }) = query.sent() {
                let timing = timing.unwrap();
                let took = f64::from(timing.queue_us + timing.step_us) * 1e-3;
                count.1 += u32::from(took + 2.0 * transit <= 16.0);
            }
        }
        let fraction = |(all, in_time): (u32, u32)| f64::from(in_time) / f64::from(all);
        let sum = counts.iter().fold((0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        Goodput {
            used: f64::from(sum.1) * STEP / 1000.0,
            least: counts.into_iter().map(fraction).fold(1.0, f64::min),
            mean: fraction(sum),
        }
    }

    #[test]
    fn nine_tenths_of_what_a_worker_can_do_are_all_answered_in_time() {
        let Goodput { used, least, .. } = loaded(72, 72, 1.0);
        assert!(used > 0.89 && least == 1.0, "{used} {least}");
    }

    #[test]
    fn at_three_times_its_capacity_a_worker_answers_in_time_and_shares_equally() {
        // In 16 ms the worker completes 64 steps: a queue of 40 vehicles is full before requests are late.
        for (queue, transit) in [(240, 0.1), (240, 1.0), (240, 3.0), (40, 1.0)] {
            let Goodput { used, least, mean } = loaded(240, queue, transit);
            assert!(used >= 0.95, "{queue} {transit}: {used}");
            let fair = least >= 0.8 * mean;
            assert!(fair, "{queue} {transit}: {least} of {mean}");
        }
    }
}
