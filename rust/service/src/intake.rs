//! From a query to the queue. Runs on the network's receive thread, so it decodes headers only.

use std::time::{Duration, Instant};

use egp_wire::keys::{self, Name, Target};
use egp_wire::{Code, Header, Invalid, Load, Ready, WireError, limits};

use crate::events;
use crate::guard::{Guard, Sealed};
use crate::metrics::{Metrics, micros};
use crate::offer::Offer;
use crate::query::{Query, check_attachment, no_such_key};
use crate::queue::{Queue, Refused};
use crate::standing::Standing;
use crate::sync::atomic::{AtomicBool, Ordering};
use crate::traces::Traces;

/// An eighth of a budget is reserved for the transfer of request and answer, whose time the service cannot measure. Without
/// this reserve an overloaded service would compute answers that arrive shortly after their deadline.
const TRANSIT: u32 = 8;

/// The end of the error about a key that is not served, for [`no_such_key`].
const OF_A_REPLICA: &str = "no key of this replica: expected egp/v1/r/REPLICA/FLEET/VEHICLE/step or egp/v1/r/REPLICA/health, \
     ready, metrics, library/SHA256 or library/SHA256/PART, with names of 1 to 64 of A-Z a-z 0-9 . _ -";

/// A request on its way to a worker.
pub(crate) struct Job<Q> {
    pub(crate) query: Q,
    pub(crate) sequence: u64,
    pub(crate) arrived: Instant,
    pub(crate) deadline: Instant,
    /// When it was put into the queue; none if no traces are written.
    pub(crate) queued: Option<Instant>,
    /// The proof of the sender, if the service has keys.
    pub(crate) sealed: Option<Sealed>,
}

impl<Q> Job<Q> {
    /// The time by which a step must be expected to end, unless the worker would otherwise be idle.
    pub(crate) fn expected_by(&self) -> Instant {
        self.arrived + (self.deadline - self.arrived) * (TRANSIT - 1) / TRANSIT
    }

    /// The budget in microseconds.
    pub(crate) fn budget(&self) -> u32 {
        micros(self.deadline - self.arrived)
    }
}

/// The state that intake and workers share.
pub(crate) struct Shared<Q> {
    pub(crate) replica: Name,
    /// What the replica serves now.
    pub(crate) describe: Box<dyn Fn() -> Ready + Send + Sync>,
    pub(crate) workers: usize,
    pub(crate) queue: Queue<Job<Q>>,
    pub(crate) standing: Standing,
    pub(crate) metrics: Metrics,
    pub(crate) draining: AtomicBool,
    /// The keys of the vehicles; without them every sender is served.
    pub(crate) guard: Option<Guard>,
    /// The spans of requests, if they are written.
    pub(crate) traces: Option<Traces>,
    /// The library files, for others who fetch them.
    pub(crate) offer: Offer<Q>,
}

impl<Q: Query> Shared<Q> {
    /// Answers a query that arrived at `arrived`, queues it, or answers it with an error.
    pub(crate) fn take(&self, query: Q, arrived: Instant) {
        if let Err(error) = check_attachment(&query) {
            return self.refuse(&query, None, &error);
        }
        match keys::parse(query.key()) {
            Some(Target::Health) => {
                let key = keys::health(&self.replica);
                query.answer(&key, b"ok".to_vec(), "text/plain", None);
            }
            Some(Target::Ready) => {
                let mut description = (self.describe)();
                description.ready = !self.draining.load(Ordering::Relaxed);
                description.sealed = self.guard.is_some();
                let encoding = "application/protobuf;egp.v1.Ready";
                let (key, answer) = (keys::ready(&self.replica), description.encode());
                let proof = (self.guard.as_ref()).and_then(|guard| guard.proof(&query, &answer));
                query.answer(&key, answer, encoding, proof);
            }
            Some(Target::Metrics) => {
                let text = self.metrics.text(self.queue.len()).into_bytes();
                let encoding = "application/openmetrics-text;version=1.0.0";
                query.answer(&keys::metrics(&self.replica), text, encoding, None);
            }
            Some(Target::Library { id, part }) => {
                self.offer
                    .take(query, id, part, &self.replica, &self.metrics);
            }
            Some(Target::Step { fleet, vehicle }) => {
                match self.authenticate(&query, &fleet, &vehicle) {
                    Ok((header, sealed)) => {
                        let deadline = arrived + Duration::from_micros(header.budget_us.into());
                        let job = Job {
                            query,
                            sequence: header.sequence,
                            arrived,
                            deadline,
                            queued: self.traces.as_ref().map(|_| Instant::now()),
                            sealed,
                        };
                        self.admit(format!("{fleet}/{vehicle}"), job);
                    }
                    Err((sequence, error)) => self.refuse(&query, sequence, &error),
                }
            }
            None => self.refuse(&query, None, &no_such_key(query.key(), OF_A_REPLICA)),
        }
    }

    /// The header of a request, and the proof of its sender if the service has keys; or the error, with the sequence number
    /// if the header was read.
    fn authenticate(
        &self,
        query: &Q,
        fleet: &Name,
        vehicle: &Name,
    ) -> Result<(Header, Option<Sealed>), (Option<u64>, WireError)> {
        if query.key() != keys::step(&self.replica, fleet, vehicle) {
            return Err((None, no_such_key(query.key(), OF_A_REPLICA)));
        }
        let (limit, actual) = (limits::MESSAGE_BYTES, query.length());
        if actual > limit {
            // The payload is not read: several parts of it would be copied first.
            return Err((None, Invalid::TooLarge { limit, actual }.into()));
        }
        let header = Header::decode(&query.payload()).map_err(|e| (None, e.into()))?;
        let guard = self.guard.as_ref();
        let sealed = guard.map(|guard| guard.request(query, fleet, vehicle));
        match sealed.transpose() {
            Ok(sealed) => Ok((header, sealed)),
            Err(error) => Err((Some(header.sequence), error)),
        }
    }

    /// Queues a request of a vehicle, or answers it with an error.
    fn admit(&self, vehicle: String, job: Job<Q>) {
        let (arrived, deadline) = (job.arrived, job.deadline);
        // A request for an idle worker is queued in any case, because only computed steps correct the estimate.
        let idle = |ahead| ahead + self.metrics.busy_workers() < self.workers;
        // If the queue has not been short for a while (`standing`), a request is queued only if half of its budget remains for
        // the network.
        let latest = if self.standing.is_standing(arrived) {
            arrived + (deadline - arrived) / 2
        } else {
            job.expected_by()
        };
        let in_time = |ahead| {
            if idle(ahead) {
                self.standing.note_short(arrived);
                return true;
            }
            arrived + self.time_to_answer(ahead) <= latest
        };
        let pushed = self.queue.push(vehicle, deadline, job, in_time);
        if let Some(old) = pushed.superseded {
            let detail = "a newer request of this vehicle took the place of this one";
            self.refuse_job(&old, &WireError::permanent(Code::Superseded, detail));
        }
        for refused in pushed.displaced.into_iter().chain(pushed.queued.err()) {
            match refused {
                Refused::Full(job) => self.refuse_job(&job, &self.overloaded()),
                Refused::Late(job) => self.refuse_job(&job, &self.too_late(job.budget())),
                Refused::Closed(job) => {
                    let detail = "this replica is shutting down; ask another one";
                    self.refuse_job(&job, &WireError::retryable(Code::Draining, 0, detail));
                }
            }
        }
    }

    /// The expected time of an answer behind `ahead` waiting requests, from the smoothed time of a step.
    pub(crate) fn time_to_answer(&self, ahead: usize) -> Duration {
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
        let traced = self.traces.as_ref().map(|traces| (traces, Instant::now()));
        self.refuse(&job.query, Some(job.sequence), error);
        if let Some((traces, ended)) = traced {
            traces.answered(&self.replica, job, None, ended, Err(error));
        }
    }

    /// Sends an error and counts it.
    pub(crate) fn refuse(&self, query: &Q, sequence: Option<u64>, error: &WireError) {
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

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
pub(crate) mod tests {
    use egp_testing::messages;
    use egp_wire::KeyRing;

    use super::*;
    use crate::query::recorded::{Recorded, Sent, at, name};

    /// What a service with a queue of two vehicles shares. A step is expected to take 7 ms.
    pub(crate) fn shared(workers: usize) -> Shared<Recorded> {
        let metrics = Metrics::new(&[], workers);
        metrics.stepped(Duration::from_millis(7));
        Shared {
            replica: name("main"),
            describe: Box::new(messages::ready),
            workers,
            queue: Queue::new(2),
            standing: Standing::default(),
            metrics,
            draining: AtomicBool::new(false),
            guard: None,
            traces: None,
            offer: Offer::none(),
        }
    }

    /// Takes a request that arrives at `start`.
    fn take(shared: &Shared<Recorded>, start: Instant, vehicle: &str, budget_us: u32) -> Recorded {
        let query = Recorded::request(vehicle, 1, budget_us);
        shared.take(query.clone(), start);
        query
    }

    #[test]
    fn a_request_waits_if_its_answer_is_expected_within_seven_eighths_of_the_budget() {
        let (shared, start) = (shared(1), Instant::now());
        shared.metrics.busy.inc();
        // One step runs, so the answer is expected after two steps, 14 ms.
        let late = take(&shared, start, "a", 15_999).error().unwrap();
        assert_eq!((late.code, late.retryable), (Code::TooLate, true));
        assert_eq!(late.retry_after_us, 14_000);
        assert!(late.detail.contains("within 15999 us"), "{late}");
        assert_eq!(take(&shared, start, "a", 16_000).sent(), None);
        let job = shared.queue.pop().unwrap();
        assert_eq!(job.deadline, at(start, 16.0));
        assert_eq!((job.arrived, job.sequence), (start, 1));
    }

    #[test]
    fn an_idle_worker_tries_however_long_a_step_is_expected_to_take() {
        let (shared, start) = (shared(2), Instant::now());
        shared.metrics.busy.inc();
        assert_eq!(take(&shared, start, "a", 1_000).sent(), None);
        // The request that waits occupies the other worker.
        assert_eq!(take(&shared, start, "b", 2_000).code(), Some(Code::TooLate));
    }

    #[test]
    fn workers_share_what_waits() {
        let (shared, start) = (shared(2), Instant::now());
        shared.metrics.busy.set(2);
        assert_eq!(take(&shared, start, "a", 16_000).sent(), None);
        // Three steps are before this one, which therefore ends with the second round of the two workers, too.
        assert_eq!(take(&shared, start, "b", 16_001).sent(), None);
        let load = Load {
            queued: 2,
            busy: 2,
            workers: 2,
            step_us: 7_000,
        };
        assert_eq!(shared.load(), load);
        let full = take(&shared, start, "c", 90_000).error().unwrap();
        assert_eq!((full.code, full.retry_after_us), (Code::Overloaded, 21_000));
        assert!(full.detail.contains("2 vehicles"), "{full}");
    }

    #[test]
    fn a_newer_request_and_a_closed_queue_are_told_to_the_vehicle() {
        let (shared, start) = (shared(1), Instant::now());
        let old = take(&shared, start, "a", 20_000);
        let new = take(&shared, start, "a", 20_000);
        assert_eq!((old.code(), new.sent()), (Some(Code::Superseded), None));
        shared.queue.close();
        assert_eq!(
            take(&shared, start, "b", 20_000).code(),
            Some(Code::Draining)
        );
        let text = shared.metrics.text(0);
        assert!(text.contains("{outcome=\"superseded\"} 1"), "{text}");
        assert!(text.contains("{outcome=\"draining\"} 1"), "{text}");
    }

    #[test]
    fn requests_of_another_replica_and_too_large_ones_are_not_read() {
        let (shared, start) = (shared(1), Instant::now());
        let asked = |change: &dyn Fn(&mut Recorded)| {
            let mut query = Recorded::request("a", 1, 20_000);
            change(&mut query);
            shared.take(query.clone(), start);
            query.error()
        };
        let other = asked(&|query| query.key = query.key.replace("/main/", "/other/")).unwrap();
        assert_eq!(other.code, Code::Malformed);
        assert!(other.detail.contains("no key of this replica"), "{other}");
        let none = asked(&|query| query.key = "egp/v1/r/main/a\n\u{1b}[31m".to_owned()).unwrap();
        assert!(
            none.detail
                .starts_with("egp/v1/r/main/a\\n\\u{1b}[31m is no key"),
            "{none}"
        );
        let limit = limits::MESSAGE_BYTES;
        let large = asked(&|query| query.length = limit + 1).unwrap();
        assert!(large.detail.contains("at most"), "{large}");
        assert_eq!(asked(&|query| query.length = limit), None);
        assert_eq!(
            asked(&|query| query.payload = vec![0xff]).unwrap().code,
            Code::Malformed
        );
    }

    /// Payload of the answer, and its tag if it has an attachment.
    fn answer(query: &Recorded, expected: &str) -> (Vec<u8>, Option<Vec<u8>>) {
        match query.sent() {
            Some(Sent::Answer {
                key,
                payload,
                timing,
            }) => {
                assert_eq!(key, expected);
                (payload, timing.map(|timing| timing.tag))
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_replica_describes_itself() {
        let (mut shared, start) = (shared(1), Instant::now());
        let ring = KeyRing::parse(&format!("fleet/a {}", "a1".repeat(32))).unwrap();
        let key = ring.get(&name("fleet"), &name("a")).unwrap().clone();
        shared.guard = Some(Guard::new(ring));
        let seal = |about: &str| egp_wire::Seal {
            vehicle: (name("fleet"), name("a")),
            run: 1,
            number: 1,
            tag: key.question(about, 1, 1, &[]),
        };
        let ask = |about: &str, seal: Option<egp_wire::Seal>| {
            let mut query = Recorded::new(&format!("egp/v1/r/main/{about}"), Vec::new());
            query.attachment = seal.map_or_else(Vec::new, |seal| seal.encode());
            shared.take(query.clone(), start);
            query
        };
        let health = answer(&ask("health", None), "egp/v1/r/main/health");
        assert_eq!(health, (b"ok".to_vec(), None));
        let (metrics, _) = answer(&ask("metrics", None), "egp/v1/r/main/metrics");
        assert!(String::from_utf8(metrics).unwrap().contains("egp_queued 0"));
        let ready = "egp/v1/r/main/ready";
        let (described, tag) = answer(&ask("ready", None), ready);
        let is_ready = |message: &[u8]| Ready::decode(message).unwrap().ready;
        assert!(is_ready(&described) && tag.is_none());
        assert!(Ready::decode(&described).unwrap().sealed);
        shared.draining.store(true, Ordering::Relaxed);
        let (described, tag) = answer(&ask("ready", Some(seal(ready))), ready);
        assert!(!is_ready(&described));
        let question = seal(ready).tag;
        assert!(key.is_answer(&question, &described, &tag.unwrap()));
        // A stranger gets the same answer without a proof.
        let (_, tag) = answer(&ask("ready", Some(seal("another key"))), ready);
        assert_eq!(tag, None);
    }
}
